"""Environments that need no data: furnished rooms path-traced from inside, and clear skies."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.light import lamps
from prt.light.cubemap import face_directions, rotate, yaw
from prt.light.environments import CachedEnvironments
from prt.light.lamps import checked_lamps
from prt.progress import track
from prt.scene.mitsuba_setup import mitsuba
from prt.trace.denoise import denoise as denoise_image
from prt.trace.room_model import BOX_TRIANGLES, BOXES, RECTANGLES, Room, random_room
from prt.trace.sky import random_sky

#: seeds of test environments lie this far from the training ones
TEST_SEEDS = 500_000


class ProceduralEnvironments(CachedEnvironments):
    """Random rooms and skies; test environments come from seeds that training never uses.

    Args:
        resolution: R of the cubemaps.
        train_rooms, train_skies, test_rooms, test_skies: how many of each.
        rotations: yaw angles in degrees of the training environments (Raghavan 2023, section 5).
        lamps: further training environments with one lamp or sun added (``prt.light.lamps``).
        spp: path samples a texel of a room.
        max_depth: surface bounces in a room.
        denoise: remove the noise left in the rooms (Open Image Denoise).
        seed: of all rooms and skies.
        normalise, clamp, mend: see :class:`CachedEnvironments`.

    Raises:
        PrtError: for a setting out of range, or without a vectorised Mitsuba.
    """

    def __init__(
        self,
        resolution: int,
        train_rooms: int = 64,
        train_skies: int = 16,
        test_rooms: int = 4,
        test_skies: int = 4,
        rotations: Sequence[float] = (0, 120, 240),
        lamps: int = 0,
        spp: int = 36,
        max_depth: int = 5,
        denoise: bool = True,
        seed: int = 0,
        normalise: bool = True,
        clamp: float | None = None,
        mend: bool = False,
    ):
        super().__init__(resolution, normalise, clamp, mend)
        counts = {
            "train_rooms": train_rooms,
            "train_skies": train_skies,
            "test_rooms": test_rooms,
            "test_skies": test_skies,
        }
        for name, count in counts.items():
            if not 0 <= count < TEST_SEEDS:
                raise PrtError(f"lighting.{name}={count} must be from 0 to {TEST_SEEDS - 1}")
        if train_rooms + train_skies < 1 or test_rooms + test_skies < 1:
            raise PrtError("lighting: at least one room or sky is needed for training and one for testing")
        if spp < 1 or max_depth < 1:
            raise PrtError(f"lighting.spp={spp} and lighting.max_depth={max_depth} must be at least 1")
        if not rotations:
            raise PrtError("lighting.rotations is empty; give [0] for no rotation")
        self.rooms = {"train": train_rooms, "test": test_rooms}
        self.skies = {"train": train_skies, "test": test_skies}
        self.rotations, self.lamps = [float(x) for x in rotations], checked_lamps(lamps)
        self.spp, self.max_depth, self.denoise, self.seed = spp, max_depth, denoise, seed

    def seeds(self, split: str, count: int) -> list[int]:
        """Seeds of one split's rooms (or skies)."""
        first = 2 * TEST_SEEDS * self.seed + (TEST_SEEDS if split == "test" else 0)
        return list(range(first, first + count))

    def names(self, split: str) -> list[str]:
        mark = "_test" if split == "test" else ""
        single = [f"room{mark}{i:02d}" for i in range(self.rooms[split])]
        single += [f"sky{mark}{i:02d}" for i in range(self.skies[split])]
        turns = self.rotations if split == "train" else [0.0]
        turned = [name + (f"_yaw{turn:g}" if turn else "") for turn in turns for name in single]
        return turned + [f"lamp{i:04d}" for i in range(self.lamps if split == "train" else 0)]

    def describe(self) -> str:
        turns, rooms, skies = ", ".join(f"{x:g}" for x in self.rotations), self.rooms, self.skies
        return (
            f"{rooms['train']} procedural rooms and {skies['train']} skies turned by {turns} degrees, "
            f"{self.lamps} with a lamp added; "
            f"tests: {rooms['test']} other rooms and {skies['test']} other skies; "
            f"{'unit mean radiance' if self.normalise else 'own exposure'}"
        )

    def split_fingerprint(self, split: str) -> dict[str, Any]:
        content = {
            "rooms": self.rooms[split],
            "skies": self.skies[split],
            "spp": self.spp,
            "max_depth": self.max_depth,
            "denoise": self.denoise,
            "seed": self.seed,
        }
        if split == "train":
            content |= {"rotations": self.rotations} | lamps.fingerprint(self.lamps)
        return content

    def build(self, split: str) -> Float[Tensor, "n 6 R R 3"]:
        R = self.resolution
        tracer = RoomTracer(R, self.spp, self.max_depth, self.denoise) if self.rooms[split] else None
        jobs = [(True, seed) for seed in self.seeds(split, self.rooms[split])]
        jobs += [(False, seed) for seed in self.seeds(split, self.skies[split])]
        single = [
            tracer.trace(random_room(seed), seed) if room and tracer else random_sky(seed, R)
            for room, seed in track(jobs, f"trace rooms and skies ({split})", len(jobs))
        ]
        if split == "test":
            return torch.stack(single)
        turned = [rotate(one, yaw(turn)) if turn else one for turn in self.rotations for one in single]
        plain = torch.stack(turned)
        return torch.cat([plain, lamps.with_lamps(plain, self.lamps, self.seed)])


class RoomTracer:
    """One Mitsuba scene whose numbers change from room to room, so its kernels are compiled once."""

    def __init__(self, R: int, spp: int, max_depth: int, denoise: bool = True):
        mi = mitsuba()
        if "scalar" in mi.variant():
            raise PrtError(
                f"procedural rooms need a vectorised Mitsuba, not {mi.variant()}: "
                "pip install karellen-llvm-core, or set lighting.train_rooms=0 lighting.test_rooms=0"
            )
        self.R, self.spp, self.denoise = R, spp, denoise
        content: dict[str, Any] = {"type": "scene", "boxes": boxes_mesh()}
        for i in range(RECTANGLES):
            content[f"light{i:02d}"] = {
                "type": "rectangle",
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
                # unequal weights from the start: Mitsuba compiles another kernel for equal ones
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "rgb", "value": 1.0},
                    "sampling_weight": 1.0 + i,
                },
            }
        self.scene = mi.load_dict(content)
        self.params = mi.traverse(self.scene)
        self.integrator = mi.load_dict({"type": "path", "max_depth": max_depth + 1, "rr_depth": 1000})

    def trace(self, room: Room, seed: int) -> Float[Tensor, "6 R R 3"]:
        """Radiance seen from the room's eye, mean over each texel."""
        mi = mitsuba()
        self.furnish(room)
        d = jittered_directions(self.R, self.spp, seed)
        sampler = mi.load_dict({"type": "independent"})
        # one seed for all rooms, whose directions differ anyway: the seed is compiled into a kernel
        sampler.seed(0, len(d))
        ray = mi.RayDifferential3f(
            mi.Ray3f(
                o=mi.Point3f(*(mi.Float(np.full(len(d), x, np.float32)) for x in room.eye)),
                d=mi.Vector3f(*(mi.Float(np.ascontiguousarray(x)) for x in d.numpy().T)),
            )
        )
        radiance, _, _ = self.integrator.sample(self.scene, sampler, ray, None, True)
        samples = torch.from_numpy(np.array(radiance).T.copy())
        cubemap = samples.reshape(6, self.R, self.R, self.spp, 3).mean(3)
        return denoised(cubemap) if self.denoise else cubemap

    def furnish(self, room: Room) -> None:
        """Put a room's numbers into the scene."""
        mi = mitsuba()
        flat = np.float32
        self.params["boxes.vertex_positions"] = mi.Float(room.vertices.reshape(-1).astype(flat))
        self.params["boxes.face_color"] = mi.Float(room.face_colours.reshape(-1).astype(flat))
        area = np.linalg.norm(np.cross(room.frames[:, :3, 0], room.frames[:, :3, 1]), axis=-1)
        power = area * room.radiance.mean(-1)
        for i in range(RECTANGLES):
            name = f"light{i:02d}"
            self.params[f"{name}.to_world"] = mi.AffineTransform4f(room.frames[i])
            self.params[f"{name}.emitter.radiance.value"] = mi.Color3f(room.radiance[i].tolist())
            self.params[f"{name}.emitter.sampling_weight"] = float(power[i] / power.sum())
        self.params.update()


def denoised(cubemap: Float[Tensor, "6 R R 3"]) -> Float[Tensor, "6 R R 3"]:
    """The four sides as one strip, floor and ceiling by themselves, through Open Image Denoise."""
    R = cubemap.shape[1]
    sides = [0, 5, 1, 4]
    out = torch.empty_like(cubemap)
    strip = denoise_image(torch.cat([cubemap[face] for face in sides], 1))
    for i, face in enumerate(sides):
        out[face] = strip[:, i * R : (i + 1) * R]
    for face in (2, 3):
        out[face] = denoise_image(cubemap[face])
    return out


def boxes_mesh():
    """The mesh of all boxes, its triangles coloured one by one."""
    mi = mitsuba()
    bsdf = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "face_color"}}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": bsdf})
    mesh = mi.Mesh(
        "boxes", 8 * BOXES, 12 * BOXES, has_vertex_normals=False, has_vertex_texcoords=False, props=properties
    )
    room = random_room(0)
    faces = BOX_TRIANGLES[None] + 8 * np.arange(BOXES)[:, None, None]
    mesh.add_attribute("face_color", 3, room.face_colours.reshape(-1).astype(np.float32))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(room.vertices.reshape(-1).astype(np.float32))
    params["faces"] = mi.UInt32(faces.reshape(-1).astype(np.uint32))
    params.update()
    return mesh


def jittered_directions(R: int, spp: int, seed: int) -> Float[Tensor, "D 3"]:
    """``spp`` directions in every texel, texel by texel; one in each cell of a grid where spp is a square."""
    generator = torch.Generator().manual_seed(seed)
    shape = (6, R, R, spp)
    jitter = torch.rand((2, *shape), generator=generator)
    side = round(spp**0.5)
    if side * side == spp:
        cell = torch.arange(spp)
        jitter = (torch.stack([cell % side, cell // side])[:, None, None, None] + jitter) / side
    place = torch.arange(R)
    u = 2 * (place[None, None, :, None] + jitter[0]) / R - 1
    v = 2 * (place[None, :, None, None] + jitter[1]) / R - 1
    face = torch.arange(6)[:, None, None, None].expand(shape)
    return face_directions(face, u, v).reshape(-1, 3)
