"""A built Mitsuba scene with names for its emitters and with further parts; its objects are used again."""

import itertools
from typing import Any

from prt.errors import PrtError
from prt.scene.mitsuba_setup import mitsuba


def free_emitters(scene: Any) -> list[Any]:
    """Emitters that belong to no shape; those of shapes come with the shapes."""
    mi = mitsuba()
    return [e for e in scene.emitters() if not mi.has_flag(e.flags(), mi.EmitterFlags.Surface)]


def name_emitters(scene: Any) -> None:
    """Call every free emitter without an id ``light0``, ``light1`` and so on.

    Mitsuba would call its parameters after its address in memory.
    """
    free = free_emitters(scene)
    taken = {part.id() for part in [*scene.shapes(), *free]}
    for emitter in free:
        if not emitter.id():
            number = next(n for n in itertools.count() if f"light{n}" not in taken)
            emitter.set_id(f"light{number}")
            taken.add(f"light{number}")


def with_parts(scene: Any, added: dict[str, dict[str, Any]], where: str) -> Any:
    """The scene with shapes and emitters beside its own, under their keys.

    Args:
        scene: a ``mi.Scene`` whose shapes and free emitters have ids.
        added: descriptions in Mitsuba's dict format, by id.
        where: what the scene was read from, for the message.

    Raises:
        PrtError: for a part that is called like one of the scene's.
    """
    mi = mitsuba()
    own = [*scene.shapes(), *free_emitters(scene)]
    # materials by themselves too: of a part alone, none is found by its name
    bsdfs = dict.fromkeys(s.bsdf() for s in scene.shapes() if s.bsdf() is not None)
    own = [*(b for b in bsdfs if b.id() and not b.id().startswith("_unnamed_")), *own]
    names = [part.id() for part in own]
    for key in added:
        if key in names:
            raise PrtError(
                f"scene.add: {where} itself has a part called {key!r}; call the added one otherwise"
            )
    # built one by one: together, equal shapes would be merged and lose their names
    more = [mi.load_dict({**part, "id": key}) for key, part in added.items()]
    parts = dict(zip((f"part{i}" for i in range(len(own) + len(more))), own + more, strict=True))
    out = mi.load_dict({"type": "scene", **parts})
    # the keys, which may not be the names (no dots, none twice), have become the names
    for part, name in zip(parts.values(), [*names, *added], strict=True):
        part.set_id(name)
    return out
