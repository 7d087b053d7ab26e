"""For tasks whose light belongs to the scene: lamps, windows and environments of its own file."""

from typing import Any


class OwnLights:
    """Chosen with ``task=animate``; names nothing and gives nothing."""

    def fingerprint(self) -> dict[str, Any]:
        return {"lighting": "own"}
