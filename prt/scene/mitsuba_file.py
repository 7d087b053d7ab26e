"""Any Mitsuba scene: an XML, YAML or JSON file or a dict; its lights removed, the environment is the light.

What is kept is geometry and materials. Sensors, the integrator and every emitter are taken out. A shape that
carries an area emitter is a lamp, a light panel or a window portal: it is removed with its emitter, because
left in place as a dark surface it would stand in the very opening the environment has to come through
(``emitting_shapes: keep`` keeps it with its BSDF).
"""

import fnmatch
import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from prt.errors import PrtError
from prt.paths import data_file, data_folder
from prt.scene.animation_file import read_animation
from prt.scene.lit_parts import name_emitters, with_parts
from prt.scene.mitsuba_nodes import children, first_sensor, name_shapes, roughness_by_pattern, set_roughness
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.scene import Scene, Trajectory, file_digest
from prt.scene.sensor_cameras import SensorPose, cameras_around_bounds, cameras_around_sensor
from prt.scene.view import View

DICT_FILES = (".yaml", ".yml", ".json")


class MitsubaScene(Scene):
    """A scene read from a Mitsuba file or dict.

    Args:
        path: an XML, YAML or JSON file, absolute, relative to the current folder, or below ``PRT_DATA``;
            or the scene itself as a dict in Mitsuba's ``load_dict`` format (4 x 4 lists are transforms).
        cameras: trajectories as in :class:`~prt.scene.scene.Scene`; None derives them from the file's own
            sensor, or from the bounding box where it has none.
        open: shapes to take out so that the environment gets in, by id; ``*`` matches any characters.
        roughness: sigma in [0, 1] for all BSDFs (GGX alpha is its square), or a dict from BSDF id pattern to
            sigma; smooth conductors, plastics and dielectrics become rough ones.
        emitting_shapes: ``remove`` or ``keep`` the shapes of area emitters.
        parameters: values for the ``$name`` parameters of an XML file.
        animation: what moves in task animate, as :func:`~prt.scene.animation_file.read_animation` takes it;
            a path is absolute, relative to the current folder or to the scene's file, or below ``PRT_DATA``.
        variables: how many of its variables move; null for all.
        add: shapes and emitters that task animate has beside the file's, by id, as in Mitsuba's dict format;
            files they name are absolute or relative to the scene's file.

    Raises:
        PrtError: for a missing or unreadable file, a pattern that matches nothing, or an ``add`` that is no
            mapping of mappings.
    """

    def __init__(
        self,
        name: str = "mitsuba",
        path: str | Path | Mapping[str, Any] | None = None,
        cameras: dict[str, list[Trajectory]] | None = None,
        max_depth: int = 8,
        record: Literal["bsdf", "nee"] = "nee",
        open: Sequence[str] = (),
        roughness: float | Mapping[str, float] | None = None,
        emitting_shapes: Literal["remove", "keep"] = "remove",
        parameters: Mapping[str, Any] | None = None,
        animation: str | Path | Mapping[str, Any] | None = None,
        variables: int | None = None,
        add: Mapping[str, Any] | None = None,
    ):
        super().__init__(name, cameras or self._derived_cameras(), max_depth, record)
        if path is None or (isinstance(path, (str, Path)) and not str(path).strip()):
            raise PrtError(
                "scene.path is not set; give a Mitsuba scene: scene.path=/folder/scene.xml (or .yaml, .json)"
            )
        if emitting_shapes not in ("remove", "keep"):
            raise PrtError(f"scene.emitting_shapes={emitting_shapes!r} is not one of remove, keep")
        if isinstance(open, str):
            raise PrtError(f"scene.open={open!r} must be a list of shape ids: scene.open=[{open}]")
        self.content = _plain(path) if isinstance(path, Mapping) else None
        self.path = None if isinstance(path, Mapping) else scene_file(path)
        self.open = [str(pattern) for pattern in open]
        self.roughness = roughness_by_pattern(roughness)
        self.emitting_shapes = emitting_shapes
        self.parameters = {key: str(value) for key, value in (parameters or {}).items()}
        self.animation = read_animation(self._animation_source(animation)).subset(variables)
        self.add = _plain(add or {})
        if not isinstance(self.add, dict) or not all(isinstance(part, dict) for part in self.add.values()):
            raise PrtError(
                f"scene.add={self.add!r} must map ids to shapes or emitters in Mitsuba's dict format, "
                "as {lamp: {type: sphere, ...}}"
            )
        self._shapes: dict[str, Any] | None = None
        self._sensor: SensorPose | None = None

    def description(self) -> dict[str, Any]:
        """The shapes, already built, by id: scenes with different emitters share them."""
        if self._shapes is None:
            self._shapes = self._build()
        return dict(self._shapes)

    def _animation_source(self, given: Any) -> Any:
        if given is None or isinstance(given, Mapping):
            return None if given is None else _plain(given)
        places = [Path(str(given)).expanduser()]
        if self.path is not None:
            places.append(self.path.parent / str(given))
        data = data_folder()
        if data is not None:
            places.append(data / str(given))
        return next((place for place in places if place.is_file()), places[0])

    def load_lit(self):
        """The file as it is, lights and all, every shape by itself under its own id.

        A shape without one is called after its BSDF, with a number: ``Wood_0001``, ``Wood_0002``. An emitter
        without one that belongs to no shape is called ``light0``, ``light1``, and so on.

        Raises:
            PrtError: for a file without emitters, one that cannot be built, or an added part that is called
                like one of the file's.
        """
        mi = mitsuba()
        config, state = _parser_config(), self._parse()
        self._sensor = first_sensor(state)
        self._strip(state, lights=True)
        set_roughness(state, self.roughness)
        name_shapes(state)
        try:
            scene = mi.parser.instantiate(config, state)
            scene = scene[0] if isinstance(scene, (list, tuple)) else scene
            name_emitters(scene)
            if self.add:
                scene = with_parts(scene, self._added(), str(self.path or "the dict"))
        except PrtError:
            raise
        except Exception as error:
            raise PrtError(f"cannot build scene.path={self.path or 'dict'}: {_one_line(error)}") from error
        if not scene.emitters():
            raise PrtError(
                f"scene.path={self.path or 'dict'} has no emitters, which task=animate needs; add a light"
            )
        return scene

    def _added(self) -> dict[str, Any]:
        """The added parts with transforms and absolute file names."""
        folder = self.path.parent if self.path is not None else Path.cwd()

        def placed(value: Any) -> Any:
            if not isinstance(value, dict):
                return value
            named = isinstance(value.get("filename"), str)
            more = {"filename": str(_find(value["filename"], [folder]))} if named else {}
            return {**{key: placed(part) for key, part in value.items()}, **more}

        return _with_transforms(placed(self.add))

    def lit_fingerprint(self) -> dict[str, Any]:
        """As for other tasks, with emitters and the files these name."""
        state = self._parse()
        mi = mitsuba()
        names = [
            n.props["filename"]
            for n in state.nodes
            if n.type == mi.ObjectType.Emitter and "filename" in n.props
        ]
        files = [file for file in names if isinstance(file, str)] + _filenames(self._added())
        for file in files:
            if not Path(file).is_file():
                raise PrtError(
                    f"scene.path={self.path or 'dict'} needs {file}, which does not exist; restore it"
                )
        maps = [cached_digest(Path(file), Path(file).stat().st_mtime_ns) for file in sorted(set(files))]
        return {**super().lit_fingerprint(), "emitters": maps, "add": _jsonable(self.add)}

    def fingerprint(self) -> dict[str, Any]:
        """The content of the file and of every file it names (SHA-256), and the options."""
        state = self._parse()
        files = sorted(set(self._files(state)))
        contents = [cached_digest(Path(file), Path(file).stat().st_mtime_ns) for file in files]
        if self.content is not None:
            contents.append(json.dumps(_jsonable(self.content), sort_keys=True))
        else:
            contents += [file_digest(Path(str(file))) for file in (state.files or [self.path])]
        digest = hashlib.sha256("\n".join(contents).encode()).hexdigest()
        return {
            "kind": "mitsuba_file",
            "content": digest,
            "open": self.open,
            "roughness": self.roughness,
            "emitting_shapes": self.emitting_shapes,
            "parameters": self.parameters,
        }

    def _derived_cameras(self) -> dict[str, list[Trajectory]]:
        """Two trajectories per split that load the scene only when the first view is asked for."""
        found: dict[str, list[Trajectory]] = {}

        def later(split: str, number: int) -> Trajectory:
            def views(places: Sequence[float]) -> list[View]:
                if not found:
                    scene = self.load()
                    found.update(
                        cameras_around_bounds(*self.bounds)
                        if self._sensor is None
                        else cameras_around_sensor(scene, self._sensor)
                    )
                return found[split][number](places)

            return views

        return {split: [later(split, 0), later(split, 1)] for split in ("train", "far")}

    def _parse(self):
        """Mitsuba's parsed scene: references resolved, file names absolute."""
        mi = mitsuba()
        config = _parser_config()
        try:
            if self.content is not None or self.path.suffix.lower() in DICT_FILES:
                content = self.content if self.content is not None else _read_dict(self.path)
                state = mi.parser.parse_dict(config, _with_transforms({"type": "scene", **content}))
            else:
                state = mi.parser.parse_file(config, str(self.path), **self.parameters)
            mi.parser.transform_upgrade(config, state)
            mi.parser.transform_resolve(config, state)
        except PrtError:
            raise
        except Exception as error:
            raise PrtError(f"cannot read scene.path={self.path or 'dict'}: {_one_line(error)}") from error
        if state.root.props.plugin_name() != "scene":
            raise PrtError(f"scene.path={self.path} holds a {state.root.props.plugin_name()!r}, not a scene")
        folder = self.path.parent if self.path is not None else Path.cwd()
        for node in state.nodes:
            if "filename" in node.props and isinstance(node.props["filename"], str):
                places = [folder, Path(str(state.files[node.file_index])).parent] if state.files else [folder]
                node.props["filename"] = str(_find(node.props["filename"], places))
        return state

    def _files(self, state) -> list[str]:
        """The files of geometry and materials (emitters do not count: they go)."""
        mi = mitsuba()
        names = (
            n.props["filename"]
            for n in state.nodes
            if n.type != mi.ObjectType.Emitter and "filename" in n.props
        )
        files = [name for name in names if isinstance(name, str)]
        for file in files:
            if not Path(file).is_file():
                raise PrtError(
                    f"scene.path={self.path or 'dict'} needs {file}, which does not exist; restore it"
                )
        return files

    def _build(self) -> dict[str, Any]:
        mi = mitsuba()
        config, state = _parser_config(), self._parse()
        self._sensor = first_sensor(state)
        self._strip(state)
        set_roughness(state, self.roughness)
        self._files(state)
        try:
            mi.parser.transform_merge_equivalent(config, state)
            mi.parser.transform_merge_meshes(config, state)
            scene = mi.parser.instantiate(config, state)
        except Exception as error:
            raise PrtError(f"cannot build scene.path={self.path or 'dict'}: {_one_line(error)}") from error
        scene = scene[0] if isinstance(scene, (list, tuple)) else scene
        shapes = list(scene.shapes())
        if not shapes:
            raise PrtError(f"scene.path={self.path or 'dict'} has no shapes left; nothing to look at")
        return {f"{_key(shape.id())}_{i}": shape for i, shape in enumerate(shapes)}

    def _strip(self, state, lights: bool = False) -> None:
        """Take out emitters (unless they are wanted), sensors, integrators, and shapes to be opened."""
        mi = mitsuba()
        unwanted = (mi.ObjectType.Sensor, mi.ObjectType.Integrator)
        unwanted += () if lights else (mi.ObjectType.Emitter,)
        ids: set[str] = set()
        gone: set[int] = set()
        for index, node in enumerate(state.nodes):
            if node.type == mi.ObjectType.Shape:
                ids.add(node.props.id())
                emits = any(state.nodes[i].type == mi.ObjectType.Emitter for _, i in children(node))
                opened = any(fnmatch.fnmatchcase(node.props.id(), pattern) for pattern in self.open)
                if opened or (emits and self.emitting_shapes == "remove" and not lights):
                    gone.add(index)
            elif node.type in unwanted:
                gone.add(index)
        for pattern in self.open:
            if not fnmatch.filter(ids, pattern):
                raise PrtError(
                    f"scene.open: no shape of {self.path or 'the dict'} is called {pattern!r}; "
                    f"some that exist: {', '.join(sorted(ids)[:8])}"
                )
        for node in state.nodes:
            for key, index in children(node):
                if index in gone:
                    del node.props[key]


def scene_file(path: str | Path) -> Path:
    """A scene file given absolute, relative to the current folder, or below ``PRT_DATA``."""
    given = Path(path).expanduser()
    if given.is_absolute() or given.exists():
        if not given.is_file():
            raise PrtError(
                f"scene.path={given} does not exist or is no file; give a Mitsuba .xml, .yaml or .json"
            )
        return given.resolve()
    if data_folder() is None and not str(path).startswith("scenes/"):
        raise PrtError(f"scene.path={given} does not exist (looked in {Path.cwd()}; PRT_DATA is not set)")
    return data_file(str(path))


@functools.cache
def cached_digest(path: Path, modified: int) -> str:
    """SHA-256 of a file, read once per process as long as it is not modified."""
    return file_digest(path)


def _parser_config():
    mi = mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    # Scenes in the wild carry stray properties and parameters; they are no reason not to look at one.
    config.unused_parameters = mi.LogLevel.Debug
    config.unused_properties = mi.LogLevel.Debug
    return config


def _find(name: str, folders: list[Path]) -> Path:
    """An existing file of this name in one of the folders, or where it was first expected."""
    if Path(name).is_absolute():
        return Path(name)
    found = [folder / name for folder in folders if (folder / name).exists()]
    return (found or [folders[0] / name])[0].resolve()


def _read_dict(path: Path) -> dict[str, Any]:
    import yaml

    content = json.loads(path.read_text()) if path.suffix == ".json" else yaml.safe_load(path.read_text())
    if not isinstance(content, dict):
        raise PrtError(f"scene.path={path} must hold a mapping in Mitsuba's dict format")
    return content


def _plain(value: Any) -> Any:
    """Hydra's containers as plain dicts and lists; anything else as it is."""
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        return [_plain(part) for part in value]
    return value


def _with_transforms(value: Any) -> Any:
    """4 x 4 lists as Mitsuba transforms, all the way down."""
    if isinstance(value, dict):
        return {key: _with_transforms(part) for key, part in value.items()}
    if (
        isinstance(value, list)
        and len(value) == 4
        and all(isinstance(r, list) and len(r) == 4 for r in value)
    ):
        return mitsuba().ScalarTransform4f(value)
    return value


def _filenames(value: Any) -> list[str]:
    """All file names in nested dicts."""
    if not isinstance(value, dict):
        return []
    own = [value["filename"]] if isinstance(value.get("filename"), str) else []
    return own + [name for part in value.values() for name in _filenames(part)]


def _jsonable(value: Any) -> Any:
    """For fingerprints: containers as they are, numbers and strings plain, anything else by its text."""
    if isinstance(value, dict):
        return {key: _jsonable(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_jsonable(part) for part in value]
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


def _key(identifier: str) -> str:
    """A shape id as a dict key Mitsuba accepts."""
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in identifier) or "shape"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
