"""A scene whose geometry is a signed distance function: of this project, or the user's own."""

import contextlib
import importlib
import inspect
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from prt.errors import PrtError
from prt.scene.field_scene import PROBE, Corner, Distance, FieldScene, numbers
from prt.scene.scene import Trajectory, file_digest
from prt.scene.sdf import Sdf


class SdfScene(FieldScene):
    """One opaque, diffuse object of one colour, bounded by the zero set of a distance function.

    The function is imported when it is first needed.

    Args:
        cameras, name, max_depth, record, albedo: as in :class:`~prt.scene.field_scene.FieldScene`.
        function: ``module:name``, importable, or a module of the current folder. Called without arguments
            it returns an :class:`~prt.scene.sdf.Sdf`, or a distance function. With one required parameter
            it is the distance function itself: points (N, 3) to distances (N,) in torch, negative inside,
            1-Lipschitz, differentiable by autograd. An ``Sdf`` may also stand there by itself.
        bounds: two corners of a box that holds the whole zero set, world units.

    Raises:
        PrtError: if a setting is out of range.
    """

    def __init__(
        self,
        cameras: dict[str, list[Trajectory]],
        name: str = "sdf",
        max_depth: int = 2,
        record: Literal["bsdf", "nee"] = "bsdf",
        function: str | None = None,
        bounds: Sequence[Sequence[float]] = ((-1.1, -1.1, -1.1), (1.1, 1.1, 1.1)),
        albedo: Sequence[float] = (0.8, 0.8, 0.8),
    ):
        super().__init__(cameras, name, max_depth, record, albedo)
        if not isinstance(function, str) or not all(function.partition(":")):
            raise PrtError(
                f"scene.function={function!r} must be module:function; "
                "give e.g. scene.function=prt.scene.sdf_shapes:car, or my_file:my_function"
            )
        self.function = function
        self._bounds = _box(bounds)
        self._found: tuple[Sdf | None, Distance] | None = None
        # what was named, and what it returned
        self._origins: list[Any] = []

    @property
    def bounds(self) -> tuple[Corner, Corner]:
        """Corners of the box that holds the zero set, world units, as given."""
        return self._bounds

    @property
    def sdf(self) -> Sdf | None:
        """The distance as an expression; None where it is a torch function.

        Raises:
            PrtError: if the function cannot be imported or gives no distance; so the others below.
        """
        return self._load_function()[0]

    @property
    def distance(self) -> Distance:
        """From points (N, 3) to distances (N,), negative inside; differentiable.

        A torch function's result is checked at each call; PrtError for another shape, or NaN.
        """
        return self._load_function()[1]

    def fingerprint(self) -> dict[str, Any]:
        """The expression's GLSL text, or digests of the files that hold a torch function; and the settings.

        What such a file imports from others is not seen: a change there needs another cache folder.
        """
        sdf = self.sdf
        if sdf is not None:
            what = {"glsl": sdf.glsl()}
        else:
            what = {"function": self.function, "files": [file_digest(file) for file in self._files()]}
        bounds = [list(corner) for corner in self.bounds]
        return {"scene": "sdf", **what, "bounds": bounds, "albedo": list(self.albedo)}

    def without_surface(self, least: float, most: float) -> str:
        return (
            f"scene.function={self.function}: the function has no zero set inside scene.bounds; check "
            f"that {list(map(list, self.bounds))} holds the shape, that distances are negative inside "
            f"and positive outside (found {least:.3g} to {most:.3g}), and "
            f"that no shape is thinner than a {PROBE}th of the box"
        )

    def _load_function(self) -> tuple[Sdf | None, Distance]:
        if self._found is None:
            with _CurrentFolder():
                self._found = self._resolved(self._imported())
        return self._found

    def _imported(self) -> Any:
        """What ``module:name`` names."""
        module_name, _, name = self.function.partition(":")
        try:
            module = importlib.import_module(module_name)
        except Exception as error:  # a user's module may raise anything
            raise PrtError(
                f"scene.function={self.function}: cannot import {module_name} ({_one_line(error)}); give a "
                f"module of the current folder {Path.cwd()} or an installed one"
            ) from error
        self._origins = [module]
        try:
            return getattr(module, name)
        except AttributeError as error:
            own = [
                n
                for n, v in vars(module).items()
                if callable(v) and getattr(v, "__module__", "") == module_name
            ]
            raise PrtError(
                f"scene.function={self.function}: {module_name} has no {name!r}; choose one of its "
                f"functions: {', '.join(own[:8]) or 'it has none'}"
            ) from error

    def _resolved(self, found: Any) -> tuple[Sdf | None, Distance]:
        """The distance that the named thing is, or that it returns."""
        self._origins.append(found)
        if not isinstance(found, Sdf) and callable(found) and _required(found) == 0:
            try:
                found = found()
            except PrtError:
                raise
            except Exception as error:
                raise PrtError(
                    f"scene.function={self.function} failed: {_one_line(error)}; mend it"
                ) from error
            self._origins.append(found)
        if isinstance(found, Sdf):
            return found, found.distance
        if isinstance(found, type) or not callable(found) or _required(found) > 1:
            raise PrtError(
                f"scene.function={self.function} gives {type(found).__name__}, no distance; let it take "
                "points (N, 3) and return distances (N,), or take nothing and return an Sdf"
            )
        return None, self._checked(found)

    def _checked(self, function: Callable[[Tensor], Any]) -> Distance:
        """The function, its results looked at."""

        def distance(position: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
            try:
                found = function(position)
            except PrtError:
                raise
            except Exception as error:
                raise PrtError(
                    f"scene.function={self.function} failed at positions {tuple(position.shape)}: "
                    f"{_one_line(error)}; it takes points (N, 3)"
                ) from error
            shape = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
            if shape != position.shape[:1]:
                raise PrtError(
                    f"scene.function={self.function} returned {shape} for positions "
                    f"{tuple(position.shape)}; return a tensor ({len(position)},), one distance per point"
                )
            if found.isnan().any():
                where = position[found.isnan().nonzero()[0, 0]].tolist()
                raise PrtError(f"scene.function={self.function} returned NaN at {where}; guard its roots")
            return found

        return distance

    def _files(self) -> list[Path]:
        """Source files of the module that was named, and of the functions that came from it."""
        named = self._origins[0]
        modules = [named]
        for function in self._origins[1:]:
            if inspect.isfunction(function):
                modules.append(sys.modules.get(function.__module__, named))
        files = [getattr(module, "__file__", None) for module in modules]
        if None in files:
            raise PrtError(f"scene.function={self.function} is in no file; put it into one: my_file.py")
        return sorted({Path(file) for file in files if file})


class _CurrentFolder:
    """The current folder first among those that modules are imported from, within a ``with``."""

    def __enter__(self) -> None:
        self.folder = str(Path.cwd())
        sys.path.insert(0, self.folder)
        # a module written since the last import would be overlooked
        importlib.invalidate_caches()

    def __exit__(self, *exception: object) -> None:
        with contextlib.suppress(ValueError):  # where the module took it out itself
            sys.path.remove(self.folder)


def _required(function: Callable[..., Any]) -> int:
    """Positional arguments that have to be given; 1 where a callable does not tell."""
    if isinstance(function, torch.nn.Module):
        function = function.forward
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 1
    return sum(
        p.default is p.empty and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters
    )


def _box(bounds: Any) -> tuple[Corner, Corner]:
    if isinstance(bounds, (str, bytes)) or not isinstance(bounds, Sequence) or len(bounds) != 2:
        raise PrtError(f"scene.bounds={bounds!r} must be two corners; give [[x, y, z], [x, y, z]]")
    low, high = (numbers("bounds", corner) for corner in bounds)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise PrtError(
            f"scene.bounds={[list(low), list(high)]}: the first corner must lie below the second in x, y "
            "and z; swap them"
        )
    return low, high


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
