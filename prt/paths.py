"""Where data, caches and runs lie, all from the environment so that no path is written into a config."""

import os
from pathlib import Path

from prt.errors import PrtError

DATA_HELP = (
    "set PRT_DATA to a folder holding hdri/, lpips/, meshes/ and scenes/ "
    "(Mitsuba scenes: https://mitsuba.readthedocs.io/en/stable/src/gallery.html; "
    "environment maps: https://polyhaven.com/hdris)"
)


def data_folder() -> Path | None:
    """The folder named by ``PRT_DATA``, or None where it is unset."""
    value = os.environ.get("PRT_DATA", "").strip()
    return Path(value).expanduser() if value else None


def data_file(relative: str) -> Path:
    """The path of a data file below ``PRT_DATA``.

    Raises:
        PrtError: if the folder is not set or the file is missing; says where it was expected.
    """
    folder = data_folder()
    if folder is None:
        raise PrtError(f"this needs {relative!r} from the data folder, but PRT_DATA is not set; {DATA_HELP}")
    path = folder / relative
    if not path.exists():
        raise PrtError(f"data file not found: expected {path}; {DATA_HELP}")
    return path


def cache_folder() -> Path:
    """``PRT_CACHE``, or ``prt`` in the user's cache folder."""
    value = os.environ.get("PRT_CACHE", "").strip()
    if value:
        return Path(value).expanduser()
    base = os.environ.get("XDG_CACHE_HOME", "").strip()
    return (Path(base) if base else Path.home() / ".cache") / "prt"
