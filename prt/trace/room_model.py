"""A random furnished room as plain arrays: boxes with coloured faces, glowing rectangles, and an eye.

Every room has the same number of boxes and rectangles; those it does not need lie parked under the floor. So
a renderer can keep one scene and change only its numbers.
"""

import dataclasses
import math

import numpy as np

#: the room itself, furniture, and two bars for each window
FURNITURE, WINDOWS, BANDS, LAMPS, PATCHES = 24, 3, 3, 6, 2
BOXES = 1 + FURNITURE + 2 * WINDOWS
RECTANGLES = WINDOWS * BANDS + LAMPS + PATCHES
#: the four walls: axis across the wall, its side, axis along it
WALLS = ((0, -1, 2), (0, 1, 2), (2, -1, 0), (2, 1, 0))
_PARKED = np.array([0.0, -100.0, 0.0])
#: corners of the unit box, x fastest, and the two triangles of each face (-x, +x, -y, +y, -z, +z)
_CORNERS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
_QUADS = np.array([[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]])
BOX_TRIANGLES = np.concatenate([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]], 1).reshape(12, 3)


@dataclasses.dataclass
class Room:
    """Metres, y up, linear RGB.

    Attributes:
        vertices: (BOXES * 8, 3).
        face_colours: (BOXES * 12, 3) diffuse reflectance of every triangle of the boxes.
        frames: (RECTANGLES, 4, 4) from the square [-1, 1]^2 with normal +z to a glowing rectangle.
        radiance: (RECTANGLES, 3), zero for one that is not used.
        eye: (3,) where the environment is seen from.
    """

    vertices: np.ndarray
    face_colours: np.ndarray
    frames: np.ndarray
    radiance: np.ndarray
    eye: np.ndarray


def random_room(seed: int) -> Room:
    """Room number ``seed``; equal seeds give equal rooms."""
    return _Builder(np.random.default_rng(seed)).room()


class _Builder:
    def __init__(self, rng: np.random.Generator):
        self.rng = rng
        self.boxes: list[tuple[np.ndarray, np.ndarray]] = []
        self.frames: list[np.ndarray] = []
        self.radiance: list[np.ndarray] = []
        width, depth, height = rng.uniform(3, 9), rng.uniform(3, 9), rng.uniform(2.4, 4)
        #: half sizes; the floor is y = 0
        self.half = np.array([width / 2, height / 2, depth / 2])
        self.eye = np.array(
            [rng.uniform(-0.5, 0.5) * width / 2, rng.uniform(0.8, 1.8), rng.uniform(-0.5, 0.5) * depth / 2]
        )

    def room(self) -> Room:
        rng = self.rng
        self.shell()
        kinds = [self.cabinet, self.table, self.picture, self.rug, self.clutter]
        for kind in rng.choice(len(kinds), rng.integers(8, FURNITURE - 2), p=[0.3, 0.2, 0.2, 0.1, 0.2]):
            if len(self.boxes) < FURNITURE:
                kinds[kind]()
        windows = int(rng.choice(WINDOWS + 1, p=[0.25, 0.3, 0.25, 0.2]))
        lamps = int(rng.integers(0 if windows else 1, LAMPS + 1))
        daylight = math.exp(rng.normal(2.3, 0.7))
        for wall in rng.permutation(4)[:windows]:
            self.window(int(wall), daylight)
        if windows and rng.random() < 0.5:
            for _ in range(rng.integers(1, PATCHES + 1)):
                self.sun_patch(daylight)
        glow = lamp_colour(rng) * math.exp(rng.normal(2.7, 0.8))
        for _ in range(lamps):
            self.lamp(glow)
        while len(self.boxes) < BOXES:
            self.boxes.append((_CORNERS * 0.01 + _PARKED, np.zeros((12, 3))))
        while len(self.frames) < RECTANGLES:
            self.frames.append(frame(_PARKED, np.eye(3) * 0.01))
            self.radiance.append(np.zeros(3))
        return Room(
            np.concatenate([box[0] for box in self.boxes]),
            np.concatenate([box[1] for box in self.boxes]),
            np.stack(self.frames),
            np.stack(self.radiance),
            self.eye,
        )

    # ---- surfaces

    def shell(self) -> None:
        """Walls, floor and ceiling: pale walls of one tint, sometimes one in a strong colour."""
        rng = self.rng
        tint = colour(rng, saturation=rng.uniform(0, 0.35), value=rng.uniform(0.45, 0.85))
        faces = np.repeat(tint[None], 6, 0)
        faces[2] = colour(
            rng, hue=rng.uniform(0.02, 0.13), saturation=rng.uniform(0.1, 0.7), value=rng.uniform(0.1, 0.6)
        )
        faces[3] = np.full(3, rng.uniform(0.6, 0.88))
        if rng.random() < 0.4:
            faces[rng.choice([0, 1, 4, 5])] = colour(rng, saturation=rng.uniform(0.5, 0.95), value=0.7)
        centre = np.array([0, self.half[1], 0])
        self.boxes.append((_CORNERS * self.half + centre, np.repeat(faces, 2, 0)))

    def box(self, centre: np.ndarray, half: np.ndarray, turn: float, paint: np.ndarray) -> None:
        """A box standing anywhere but around the eye."""
        if np.hypot(*(centre - self.eye)[[0, 2]]) < np.hypot(half[0], half[2]) + 0.25:
            if abs(centre[1] - self.eye[1]) < half[1] + 0.25:
                return
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        self.boxes.append((_CORNERS * half @ rotation.T + centre, np.repeat(paint[None], 12, 0)))

    def place(self, wall: int, along: float, height: float, offset: float) -> np.ndarray:
        """A point ``offset`` metres inside a wall; ``along`` in [-1, 1]."""
        axis, side, other = WALLS[wall]
        point = np.array([0.0, height, 0.0])
        point[axis] = side * (self.half[axis] - offset)
        point[other] = along * self.half[other]
        return point

    def against_wall(self, wall: int, width: float, height: float, depth: float) -> np.ndarray:
        """Half sizes of a box of this width along the wall."""
        half = np.array([width, height, width]) / 2
        half[WALLS[wall][0]] = depth / 2
        return half

    def cabinet(self) -> None:
        rng, wall = self.rng, int(self.rng.integers(4))
        width, height, depth = rng.uniform(0.4, 2), rng.uniform(0.4, 2.2), rng.uniform(0.3, 0.7)
        place = self.place(wall, rng.uniform(-0.8, 0.8), height / 2, depth / 2 + 0.01)
        self.box(place, self.against_wall(wall, width, height, depth), 0, wood_or_paint(rng))

    def table(self) -> None:
        rng = self.rng
        place = np.array([*(rng.uniform(-0.6, 0.6, 2) * self.half[[0, 2]])])
        half = np.array([rng.uniform(0.3, 0.9), rng.uniform(0.02, 0.3), rng.uniform(0.3, 0.6)])
        height, turn = rng.uniform(0.35, 0.9), rng.uniform(0, math.pi)
        self.box(np.array([place[0], height - half[1], place[1]]), half, turn, wood_or_paint(rng))

    def picture(self) -> None:
        rng, wall = self.rng, int(self.rng.integers(4))
        half = self.against_wall(wall, rng.uniform(0.3, 1.6), rng.uniform(0.3, 1.2), 0.04)
        place = self.place(wall, rng.uniform(-0.7, 0.7), rng.uniform(1.3, 1.9), 0.03)
        self.box(place, half, 0, colour(rng, saturation=rng.uniform(0.2, 1), value=rng.uniform(0.05, 0.9)))

    def rug(self) -> None:
        rng = self.rng
        half = np.array([rng.uniform(0.5, 0.9) * self.half[0], 0.01, rng.uniform(0.3, 0.8) * self.half[2]])
        paint = colour(rng, saturation=rng.uniform(0.2, 0.9), value=rng.uniform(0.1, 0.7))
        self.box(np.array([0, 0.012 + 0.001 * len(self.boxes), 0]), half * 0.9, 0, paint)

    def clutter(self) -> None:
        rng = self.rng
        size = rng.uniform(0.08, 0.35, 3)
        x, z = rng.uniform(-0.85, 0.85, 2) * self.half[[0, 2]]
        height = rng.choice([0.0, 0.75]) + size[1]
        paint = colour(rng, saturation=rng.uniform(0.3, 1), value=rng.uniform(0.1, 0.9))
        self.box(np.array([x, height, z]), size, rng.uniform(0, math.pi), paint)

    # ---- lights

    def glow(self, centre: np.ndarray, axes: np.ndarray, radiance: np.ndarray) -> None:
        """A rectangle with half-edges ``axes[:, 0]``, ``axes[:, 1]`` that shines along ``axes[:, 2]``."""
        self.frames.append(frame(centre, axes))
        self.radiance.append(radiance)

    def window(self, wall: int, daylight: float) -> None:
        """Three bands of outside (ground, horizon, sky) behind a cross of two bars."""
        rng = self.rng
        axis, side, other = WALLS[wall]
        wide = rng.uniform(0.3, 0.8) * self.half[other]
        low = rng.uniform(0.05, 1.1)
        high = rng.uniform(max(low + 0.8, 1.8), 2 * self.half[1] - 0.15)
        along = rng.uniform(-1, 1) * (1 - wide / self.half[other]) * 0.9
        sky = daylight * np.array([0.75, 0.95, 1.25]) ** rng.uniform(-0.6, 1.6)
        ground = (
            daylight
            * rng.uniform(0.08, 0.4)
            * colour(rng, hue=rng.uniform(0.08, 0.35), saturation=0.4, value=1)
        )
        horizon = 0.5 * (sky + ground) * np.array([1.1, 1, 0.9])
        edges = low + (high - low) * np.sort(rng.uniform(0.15, 0.75, 2))
        inward = np.zeros(3)
        inward[axis] = -side
        for bottom, top, radiance in zip([low, *edges], [*edges, high], [ground, horizon, sky], strict=True):
            up = np.array([0, (top - bottom) / 2, 0])
            sideways = np.cross([0, 1, 0], inward) * wide
            centre = self.place(wall, along, (top + bottom) / 2, 0.005)
            self.glow(centre, np.stack([sideways, up, inward], 1), radiance)
        paint = np.full(3, rng.uniform(0.05, 0.8))
        centre = self.place(wall, along, (low + high) / 2, 0.03)
        for half in (
            self.against_wall(wall, 0.08, high - low, 0.04),
            self.against_wall(wall, 2 * wide, 0.08, 0.04),
        ):
            self.boxes.append((_CORNERS * half + centre, np.repeat(paint[None], 12, 0)))

    def sun_patch(self, daylight: float) -> None:
        """Sunlight on the floor: a bright skewed quadrilateral, warm and brighter than the sky."""
        rng = self.rng
        x, z = rng.uniform(-0.6, 0.6, 2) * self.half[[0, 2]]
        angle, skew = rng.uniform(0, 2 * math.pi), rng.uniform(-0.5, 0.5)
        first = np.array([math.cos(angle), 0, math.sin(angle)]) * rng.uniform(0.15, 0.6)
        second = (np.array([math.sin(angle), 0, -math.cos(angle)]) + skew * first) * rng.uniform(0.2, 0.8)
        shine = daylight * rng.uniform(1, 5) * np.array([1.2, 1, 0.75])
        self.glow(np.array([x, 0.05, z]), np.stack([first, second, [0, 1, 0]], 1), shine)

    def lamp(self, glow: np.ndarray) -> None:
        """A panel on the ceiling, or a smaller one on a wall."""
        rng = self.rng
        size = rng.uniform(0.06, 0.4, 2)
        brightness = glow * rng.uniform(0.5, 1.5) * (0.04 / size.prod()) ** 0.5
        if rng.random() < 0.7:
            x, z = rng.uniform(-0.8, 0.8, 2) * self.half[[0, 2]]
            centre = np.array([x, 2 * self.half[1] - rng.uniform(0.01, 0.5), z])
            axes = np.array([[size[0], 0, 0], [0, 0, -1], [0, size[1], 0]])
        else:
            wall = int(rng.integers(4))
            inward = np.zeros(3)
            inward[WALLS[wall][0]] = -WALLS[wall][1]
            centre = self.place(wall, rng.uniform(-0.8, 0.8), rng.uniform(1.2, 2.1), 0.06)
            axes = np.stack([np.cross([0, 1, 0], inward) * size[0], np.array([0, size[1], 0]), inward], 1)
        self.glow(centre, axes, brightness)


def frame(centre: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The 4 x 4 matrix with the columns of ``axes`` and the origin ``centre``."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, centre
    return matrix


def colour(rng: np.random.Generator, saturation: float, value: float, hue: float | None = None) -> np.ndarray:
    """Linear RGB of an HSV colour; a random hue where none is given."""
    hue = rng.random() if hue is None else hue
    wheel = np.clip(np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return value * (1 - saturation + saturation * wheel)


def wood_or_paint(rng: np.random.Generator) -> np.ndarray:
    """The colour of a piece of furniture."""
    if rng.random() < 0.5:
        return colour(
            rng, hue=rng.uniform(0.04, 0.1), saturation=rng.uniform(0.4, 0.8), value=rng.uniform(0.08, 0.6)
        )
    return colour(rng, saturation=rng.uniform(0, 0.9), value=rng.uniform(0.05, 0.85))


def lamp_colour(rng: np.random.Generator) -> np.ndarray:
    """Warm to cool white; one room in seven has coloured lamps. Mean one."""
    if rng.random() < 0.15:
        glow = colour(rng, saturation=rng.uniform(0.6, 0.95), value=1)
    else:
        glow = np.array([1.0, 0.72, 0.42]) ** rng.uniform(-0.25, 1.2)
    return glow / glow.mean()
