"""The nodes of a parsed Mitsuba scene: what refers to what, its sensor, the roughness of its BSDFs."""

import fnmatch
from collections.abc import Mapping

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba
from prt.scene.sensor_cameras import SensorPose

#: smooth BSDFs and the rough ones that take their place when a roughness is set
ROUGH_VERSION = {"conductor": "roughconductor", "plastic": "roughplastic", "dielectric": "roughdielectric"}


def children(node) -> list[tuple[str, int]]:
    """Property name and node index of everything a node refers to."""
    mi = mitsuba()
    values = ((key, node.props[key]) for key in list(node.props.keys()))
    return [
        (key, value.index()) for key, value in values if isinstance(value, mi.Properties.ResolvedReference)
    ]


def first_sensor(state) -> SensorPose | None:
    """Pose and horizontal field of view of the file's first perspective sensor."""
    mi = mitsuba()
    for node in state.nodes:
        if node.type != mi.ObjectType.Sensor or node.props.plugin_name() not in ("perspective", "thinlens"):
            continue
        aspect = 1.0
        for _, index in children(node):
            film = state.nodes[index]
            if film.type == mi.ObjectType.Film and "width" in film.props and "height" in film.props:
                aspect = float(film.props["width"]) / float(film.props["height"])
        try:
            fov = float(mi.parse_fov(node.props, aspect))
        except Exception:
            fov = 50.0
        matrix = node.props["to_world"].matrix if "to_world" in node.props else mi.ScalarTransform4f().matrix
        return SensorPose.from_matrix(matrix, fov)
    return None


def name_shapes(state) -> None:
    """Give every shape without an id one: its BSDF's (or its plugin's name) and a number: ``Wood_0001``."""
    mi = mitsuba()
    shapes = [node for node in state.nodes if node.type == mi.ObjectType.Shape]
    # Mitsuba itself writes _unnamed_0; other names may begin with an underscore as well and are kept
    unnamed = [n for n in shapes if not n.props.id() or n.props.id().startswith("_unnamed_")]
    taken, counts = {node.props.id() for node in shapes}, dict[str, int]()
    for node in unnamed:
        bsdfs = [i for _, i in children(node) if state.nodes[i].type == mi.ObjectType.BSDF]
        base = (state.nodes[bsdfs[0]].props.id() if bsdfs else "") or node.props.plugin_name()
        base = base.lstrip("_") or node.props.plugin_name()
        name = base
        while name == base or name in taken:
            counts[base] = counts.get(base, 0) + 1
            name = f"{base}_{counts[base]:04d}"
        taken.add(name)
        node.props.set_id(name)


def set_roughness(state, by_pattern: dict[str, float]) -> None:
    """Set sigma on every BSDF whose id, or that of a BSDF around it, matches."""
    mi = mitsuba()
    bsdfs = {i: node for i, node in enumerate(state.nodes) if node.type == mi.ObjectType.BSDF}

    def apply(index: int, sigma: float) -> None:
        props = bsdfs[index].props
        plugin = ROUGH_VERSION.get(props.plugin_name(), props.plugin_name())
        if plugin in ROUGH_VERSION.values():
            props.set_plugin_name(plugin)
            for key in ("alpha_u", "alpha_v"):
                if key in props:
                    del props[key]
            props["alpha"] = sigma**2
            props["distribution"] = "ggx"
        elif plugin in ("principled", "principledthin"):
            props["roughness"] = sigma
        for _, child in children(bsdfs[index]):
            if child in bsdfs:
                apply(child, sigma)

    for pattern, sigma in by_pattern.items():
        matching = [
            i for i, node in bsdfs.items() if pattern == "*" or fnmatch.fnmatchcase(node.props.id(), pattern)
        ]
        if not matching and pattern != "*":
            some = ", ".join(sorted(node.props.id() for node in bsdfs.values() if node.props.id())[:8])
            raise PrtError(f"scene.roughness: no BSDF is called {pattern!r}; some that exist: {some}")
        for index in matching:
            apply(index, sigma)


def roughness_by_pattern(value: float | Mapping[str, float] | None) -> dict[str, float]:
    if value is None:
        return {}
    by_pattern = {str(k): v for k, v in value.items()} if isinstance(value, Mapping) else {"*": value}
    for pattern, sigma in by_pattern.items():
        if isinstance(sigma, bool) or not isinstance(sigma, (int, float)) or not 0.0 <= sigma <= 1.0:
            raise PrtError(
                f"scene.roughness={sigma!r} (for {pattern!r}) must be a number from 0 (mirror) to 1, "
                "sigma, the square root of GGX alpha, or null to leave the file's own"
            )
    return {pattern: float(sigma) for pattern, sigma in by_pattern.items()}
