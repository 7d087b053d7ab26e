"""Animations read from a mapping, or a YAML or JSON file.

Our own format, as YAML or within ``conf/scene``::

    variables:
      - {name: lamp, translate: {shapes: [Lamp, Bulb], start: [0, -0.4, 0], end: [0, 0.4, 0]}}
      - {name: door, rotate: {shapes: [Door], axis: [0, 1, 0], centre: [1, 0, 2], start: 0, end: 80}}
      - {name: ball, scale: {shapes: [Ball], centre: [0, 0, 0], start: 0.5, end: 1.5}}   # or three factors
      - {name: wall, value: {parameter: WallBSDF.reflectance.value, start: [0.2, 0.2, 0.2], end: [0.5, 0, 0]}}
      - {name: sun, rotate_environment: {axis: [0, 1, 0], start: 90, end: 120}}   # on top of the file's

``rotate_environment_to`` turns it to these angles instead, whatever the file says, as the paper's scenes do.

A variable may have several of these at once. Several variables may move one shape: their motions follow each
other in the order in which they are listed. The paper's own ``animation.json`` is read as well.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from prt.errors import PrtError
from prt.scene.animation import Animation, Motion, Variable

#: keys of a motion by its kind: needed, and possible
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "translate": (("shapes", "start", "end"), ()),
    "rotate": (("shapes", "axis", "start", "end"), ("centre",)),
    "scale": (("shapes", "start", "end"), ("centre",)),
    "value": (("parameter", "start", "end"), ()),
    "rotate_environment": (("start", "end"), ("axis",)),
    "rotate_environment_to": (("start", "end"), ("axis",)),
}
#: the shape that stands for the environment in the paper's files
ENVIRONMENT = "EnvironmentMapEmitter"
#: groups of the paper's files, in the order in which its variables are numbered
GROUPS = ("common", "translate", "rotate", "scale")


def read_animation(source: Any) -> Animation:
    """From a mapping or a YAML or JSON file, in our format or the paper's; nothing moves in None.

    Raises:
        PrtError: for a file that cannot be read, an unknown or missing key, or a wrong number of values.
    """
    if source is None:
        return Animation()
    if isinstance(source, Animation):
        return source
    if isinstance(source, (str, Path)):
        path = Path(source)
        if not path.is_file():
            raise PrtError(f"scene.animation={path} does not exist; give a YAML or JSON file")
        import yaml

        try:
            text = path.read_text()
            source = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
        except (ValueError, yaml.YAMLError) as error:
            raise PrtError(f"cannot read scene.animation={path}: {' '.join(str(error).split())}") from error
    if not isinstance(source, Mapping):
        raise PrtError("scene.animation must be a mapping with a list `variables`")
    if "variables" not in source:
        return _paper(source)
    unknown = set(map(str, source)) - {"variables"}
    if unknown:
        raise PrtError(f"scene.animation: unknown key {sorted(unknown)[0]!r}; only `variables` stands there")
    entries = _entries("variables", source["variables"])
    variables = tuple(_variable(i, entry) for i, entry in enumerate(entries))
    names = [variable.name for variable in variables]
    for name in names:
        if names.count(name) > 1:
            raise PrtError(f"scene.animation: two variables are called {name!r}; name one of them otherwise")
    return Animation(variables)


def _variable(number: int, entry: dict[str, Any]) -> Variable:
    name = str(entry.pop("name", f"variable{number}"))
    unknown = [key for key in entry if key not in KINDS]
    if unknown or not entry:
        what = f"unknown key {unknown[0]!r}" if unknown else "it moves nothing"
        raise PrtError(f"scene.animation, {name}: {what}; allowed: name, {', '.join(KINDS)}")
    for kind, given in entry.items():
        if not isinstance(given, Mapping):
            raise PrtError(f"scene.animation, {name}: {kind}={given!r} must be a mapping with start and end")
    return Variable(name, tuple(_motion(name, kind, dict(given)) for kind, given in entry.items()))


def _entries(what: str, given: Any) -> list[dict[str, Any]]:
    """A list of mappings, copied; an empty one where nothing is given."""
    entries: Any = [] if given is None else given
    listed = isinstance(entries, Sequence) and not isinstance(entries, str)
    if not listed or not all(isinstance(entry, Mapping) for entry in entries):
        raise PrtError(f"scene.animation: {what} must be a list of mappings, one for each variable")
    return [{str(key): value for key, value in entry.items()} for entry in entries]


def _motion(name: str, kind: str, given: dict[str, Any]) -> Motion:
    needed, possible = KINDS[kind]
    wrong = [key for key in given if key not in (*needed, *possible)] + [k for k in needed if k not in given]
    if wrong:
        what = "missing" if wrong[0] in needed else "unknown"
        allowed = ", ".join((*needed, *possible))
        raise PrtError(f"scene.animation, {name}: {kind}: {what} key {wrong[0]!r}; it takes {allowed}")
    start, end = (_numbers(f"{name}: {kind}.{key}", given[key]) for key in ("start", "end"))
    counts = {"translate": (3,), "scale": (1, 3), "rotate": (1,), "value": None}.get(kind, (1,))
    if not start or len(start) != len(end) or (counts and len(start) not in counts):
        wanted = " or ".join(map(str, counts)) if counts else "equally many, at least one,"
        raise PrtError(
            f"scene.animation, {name}: {kind}: start has {len(start)} values and end {len(end)}; "
            f"{wanted} are needed in both"
        )
    more: dict[str, Any] = {}
    for key in ("axis", "centre"):
        if key in given:
            more[key] = _numbers(f"{name}: {kind}.{key}", given[key])
            if len(more[key]) != 3:
                raise PrtError(f"scene.animation, {name}: {kind}.{key} must have 3 values")
    if "axis" in more and not np.linalg.norm(more["axis"]) > 0:
        raise PrtError(f"scene.animation, {name}: {kind}.axis={list(more['axis'])} has no direction")
    shapes = given.get("shapes", [])
    listed = isinstance(shapes, Sequence) and not isinstance(shapes, str)
    if not listed or not all(isinstance(shape, str) for shape in shapes):
        raise PrtError(f"scene.animation, {name}: {kind}.shapes must be a list of shape ids")
    if kind == "scale" and not min(*start, *end) > 0:
        raise PrtError(
            f"scene.animation, {name}: scale: all factors must be above 0, in start {list(start)} and "
            f"end {list(end)}; begin with a small one, as 0.01"
        )
    if kind in ("translate", "rotate", "scale") and not shapes:
        raise PrtError(f"scene.animation, {name}: {kind}.shapes is empty; name at least one shape")
    if kind == "value" and not str(given["parameter"]).strip():
        raise PrtError(
            f"scene.animation, {name}: value.parameter is empty; name a parameter, as Wall.reflectance.value"
        )
    return Motion(kind, start, end, tuple(shapes), str(given.get("parameter", "")), **more)


def _numbers(what: str, value: Any) -> tuple[float, ...]:
    values: Any = [value] if isinstance(value, (int, float)) and not isinstance(value, bool) else value
    try:
        if isinstance(values, str):  # of which the single letters may be numbers
            raise TypeError("a text")
        numbers = tuple(float(x) for x in values)
    except (TypeError, ValueError) as error:
        raise PrtError(f"scene.animation, {what}={value!r} must be a number or a list of numbers") from error
    if not np.isfinite(numbers).all():
        raise PrtError(f"scene.animation, {what}={value!r} must be finite")
    return numbers


def _paper(source: Mapping[str, Any]) -> Animation:
    """The format of the paper's scenes: groups of entries, each a variable; a camera that stands still."""
    for key in source:
        if key not in (*GROUPS, "camera"):
            allowed = ", ".join(("variables", *GROUPS, "camera"))
            raise PrtError(f"scene.animation: unknown key {key!r}; allowed: {allowed}")
    camera = source.get("camera")
    if isinstance(camera, Mapping) and camera.get("active"):
        raise PrtError("scene.animation: camera.active=true: the camera is no variable here, views are free")
    variables = []
    for group in GROUPS:
        for entry in _entries(group, source.get(group)):
            name = f"{group}{len(variables)}"
            shapes = entry.pop("shape_names", [])
            if group == "common":
                given = {"value": {"parameter": entry.pop("param_name", ""), **entry}}
            elif shapes == [ENVIRONMENT]:
                entry.pop("translation", None)
                # the authors' code sets the map's transform, and their angles enclose the file's own
                given = {"rotate_environment_to": entry}
            else:
                if "translation" in entry:
                    entry["centre"] = entry.pop("translation")
                given = {group: {"shapes": shapes, **entry}}
            variables.append(_variable(len(variables), {"name": name, **given}))
    return Animation(tuple(variables))
