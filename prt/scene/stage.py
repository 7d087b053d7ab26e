"""A lit scene that moves: its state changes in place, without loading it anew or compiling kernels again."""

import difflib
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from prt.errors import PrtError
from prt.scene.animation import Animation
from prt.scene.mitsuba_setup import mitsuba


class Stage:
    """A scene with its own lights, in whatever state it was last set to.

    Shapes are always moved from where they stand in the scene's description, so that going to a state and
    back brings exactly the same data.

    Args:
        scene: with ``load_lit()`` and ``animation``.

    Attributes:
        mi_scene: the live scene.
        animation: of the scene.
        state: the last one that was set.

    Raises:
        PrtError: for a shape or parameter that the scene has not, or an environment that cannot be turned.
    """

    def __init__(self, scene: Any):
        self.mi_scene = scene.load_lit()
        self.animation: Animation = scene.animation
        self.params = mitsuba().traverse(self.mi_scene)
        self.state: list[float] | None = None
        self._now: dict[str, bytes] = {}
        start = [0.0] * self.animation.dimension
        self._rest: dict[str, np.ndarray] = {}
        self._shape_keys = {name: self._keys_of(name) for name in self.animation.shapes()}
        self._value_keys = {name: self._parameter(name) for name in self.animation.values(start)}
        self._environment = self._environment_key() if self.animation.environment(start) is not None else ""
        self._check_round()
        for name, key in self._value_keys.items():
            # a scene reads sampling weights by itself; other plain numbers become part of the kernels
            if isinstance(self.params[key], float) and not key.endswith(".sampling_weight"):
                warnings.warn(
                    f"scene.animation changes {name!r}, which Mitsuba compiles into its kernels: each new "
                    "state compiles them again; the rough version of the BSDF (roughplastic) needs none",
                    stacklevel=2,
                )
        self.set([0.5] * self.animation.dimension)

    # ---- what the names of the animation stand for

    def _known(self, key: str) -> np.ndarray:
        """The value of a parameter as the scene was loaded."""
        if key not in self._rest:
            value = self.params[key]
            matrix = getattr(value, "matrix", None)
            if matrix is None:
                self._rest[key] = np.array(value, dtype=np.float64)
            else:  # arrays of one matrix in vectorised variants
                self._rest[key] = np.array(matrix, dtype=np.float64).reshape(4, 4)
        return self._rest[key]

    def _keys_of(self, shape: str) -> list[str]:
        """Parameters that hold the place of a shape."""
        keys = [k for k in (f"{shape}.vertex_positions", f"{shape}.vertex_normals") if k in self.params]
        keys = keys or [k for k in (f"{shape}.to_world",) if k in self.params]
        if not keys:
            endings = (".vertex_positions", ".to_world")
            names = [k.rpartition(".")[0] for k in self.params.keys() if k.endswith(endings)]
            raise PrtError(
                f"scene.animation moves the shape {shape!r}, which the scene has not{near(shape, names)}"
            )
        for key in keys:
            self._known(key)
        return keys

    def _parameter(self, name: str) -> str:
        """A parameter by its full name, or without the names of nested BSDFs (``bsdf``, ``brdf_0``) in it."""
        keys = list(self.params.keys())
        if name in keys:
            return name
        first, last = name.split(".")[0], name.split(".")[-1]
        found = [k for k in keys if k.startswith(f"{first}.") and k.endswith(f".{last}") and within(name, k)]
        if len(found) != 1:
            close = f"; it may be any of {', '.join(found[:4])}" if found else near(name, keys)
            raise PrtError(f"scene.animation changes the parameter {name!r}, which the scene has not{close}")
        return found[0]

    def _environment_key(self) -> str:
        keys = list(self.params.keys())
        # of all that can be turned, an environment map alone has a scale
        owners = [k.removesuffix(".to_world") for k in keys if k.endswith(".to_world")]
        found = [f"{owner}.to_world" for owner in owners if f"{owner}.scale" in keys]
        if not found:
            raise PrtError("scene.animation turns the environment, but the scene has no environment map")
        self._known(found[0])
        return found[0]

    def _check_round(self) -> None:
        """Mitsuba makes a sphere of what would be an egg, and says so only in its log."""
        plugins = {shape.id(): shape.class_name().lower() for shape in self.mi_scene.shapes()}
        for shape in self.animation.shapes():
            kind = plugins.get(shape)
            if kind in ("sphere", "cylinder") and self.animation.scales_unevenly(shape):
                raise PrtError(
                    f"scene.animation scales the shape {shape!r} by three different factors, which a {kind} "
                    "cannot follow; give one factor, or make it a mesh"
                )

    # ---- changing the state

    def set(self, v: Sequence[float]) -> None:
        """Move everything to a state; what stays as it is costs nothing.

        Raises:
            PrtError: for a state of another length, one that is not finite, or one beyond [0, 1] in which
                something is scaled to nothing; the state is then what it was.
        """
        state = self.animation.check(v)
        if state == self.state:
            return
        transforms = self.animation.transforms(state)
        for shape, matrix in transforms.items():
            # a sphere that is turned inside out would stay so in later states
            if not np.linalg.det(matrix[:3, :3]) > 0:
                raise PrtError(
                    f"state {state} scales the shape {shape!r} to nothing or inside out; stay closer to "
                    "[0, 1], or have scene.animation scale it less"
                )
        changed = False
        for shape, matrix in transforms.items():
            changed |= self._changes(shape, matrix) and self._move(shape, matrix)
        for name, value in self.animation.values(state).items():
            changed |= self._changes(name, np.array(value)) and self._put(self._value_keys[name], value)
        turn = self.animation.environment(state)
        if turn is not None and self._changes("environment map", turn):
            rest = np.eye(4) if self.animation.places_environment else self._known(self._environment)
            changed |= self._place(self._environment, turn @ rest)
        if changed:
            self.params.update()
        self.state = state

    def _changes(self, name: str, value: np.ndarray) -> bool:
        """Whether something is to be another than it is now; it is taken for done."""
        data = value.tobytes()
        before, self._now[name] = self._now.get(name), data
        return before != data

    def _move(self, shape: str, matrix: np.ndarray) -> bool:
        for key in self._shape_keys[shape]:
            rest = self._known(key)
            if key.endswith("to_world"):
                self._place(key, matrix @ rest)
                continue
            rows = rest.reshape(-1, 3)
            if key.endswith("vertex_positions"):
                moved = rows @ matrix[:3, :3].T + matrix[:3, 3]
            else:
                moved = rows @ np.linalg.inv(matrix[:3, :3])  # normals go with the inverse transpose
                length = np.linalg.norm(moved, axis=1, keepdims=True)
                moved = np.divide(moved, length, out=rows.copy(), where=length > 0)
            self.params[key] = mitsuba().Float(np.ascontiguousarray(moved, dtype=np.float32).ravel())
        return True

    def _place(self, key: str, matrix: np.ndarray) -> bool:
        import drjit as dr

        mi = mitsuba()
        value = mi.Transform4f(mi.Matrix4f(matrix.tolist()))
        if type(self.params[key]) is not type(value):
            value = type(self.params[key])(matrix.tolist())
        else:
            dr.make_opaque(value)
        self.params[key] = value
        return True

    def _put(self, key: str, value: tuple[float, ...]) -> bool:
        self.params[key] = like(self.params[key], key, value)
        return True


def like(current: Any, key: str, value: tuple[float, ...]) -> Any:
    """A value of the kind of ``current``, opaque, so that no kernel holds it; one number fills all parts.

    Raises:
        PrtError: for a parameter that holds no numbers, or another count of them.
    """
    import drjit as dr

    kind = type(current)
    if isinstance(current, float):
        size = 1
    elif dr.is_array_v(kind) and dr.is_float_v(kind) and not dr.is_tensor_v(kind) and dr.depth_v(kind) <= 2:
        size = len(current)
    else:
        raise PrtError(
            f"scene.animation changes {key!r}, which holds a {kind.__name__}, not numbers; "
            "choose a color, a position or a single number"
        )
    if len(value) not in (1, size):
        raise PrtError(
            f"scene.animation gives {key!r} {len(value)} values, but it holds {size}; "
            f"give {'1' if size == 1 else f'1 or {size}'} in start and end"
        )
    if isinstance(current, float):
        return float(value[0])
    numbers = list(value) if len(value) == size else list(value) * size
    fresh = kind(*numbers) if dr.depth_v(kind) == 2 else kind(numbers)
    dr.make_opaque(fresh)
    return fresh


def within(name: str, key: str) -> bool:
    """Whether the parts of ``name`` are those of ``key``, in order, with some left out."""
    rest = iter(key.split("."))
    return all(part in rest for part in name.split("."))


def near(name: str, known: list[str]) -> str:
    """``; near to it: ...`` or what there is."""
    close = difflib.get_close_matches(name, known, 4, 0.5) or sorted(known)[:6]
    return f"; near to it: {', '.join(close)}" if close else ""
