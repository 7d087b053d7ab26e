"""What to use on a scene: task, method and capacity, each with its reason, from what was measured of it.

The rules are thresholds on :class:`prt.tasks.needs.Need`; they are judged against full sweeps in
``reports/overview``.
"""

import dataclasses
from collections.abc import Callable, Sequence

from prt.tasks.needs import Need

#: indirect light below this share can be left out: the error is smaller than what bands or networks lose
LITTLE_INDIRECT = 0.1
#: bands of harmonics up to which a lighting is called smooth, as the method for direct light needs it
SMOOTH = 4
#: share of near-mirror pixels from which rays are worth their time
MIRRORS = 0.02
#: change of the image below which a variable is left out, and is called small
NOTHING, LITTLE = 0.005, 0.03
#: wavelets that are offered, and sizes of a hash table
WAVELETS = (8, 16, 32, 64, 128, 256)
TABLES = range(11, 20)


@dataclasses.dataclass(frozen=True)
class Advice:
    """A choice as the override that makes it, and why."""

    override: str
    reason: str


def advise(task: str, needs: Sequence[Need]) -> list[Advice]:
    """Overrides of a run, most important first; the task's own comes first."""
    return RULES[task]({need.name: need for need in needs})


def least(options: Sequence[int], value: float | None) -> int:
    """The smallest option of at least ``value``; the largest where none is, or where nothing was enough."""
    return next((option for option in options if value is not None and option >= value), options[-1])


def for_relighting(needs: dict[str, Need]) -> list[Advice]:
    bands, share = needs["lighting/bands"], needs["share/indirect"]
    if (share.value or 0.0) < LITTLE_INDIRECT and bands.value is not None and bands.value <= SMOOTH:
        return [
            Advice(
                "task=relight_direct",
                f"only {share.shown} of the light is indirect, and {bands.shown} bands hold the lighting",
            ),
            Advice("method=learnt_sh", "transfer of few bands is small and smooth"),
            Advice(f"task.order={int(bands.value)}", f"{bands.shown} {bands.about}"),
        ]
    wavelets, rank, cells = needs["transport/wavelets"], needs["transport/rank"], needs["surface/cells"]
    count, table = least(WAVELETS, wavelets.value), least(TABLES, int(cells.value or 1).bit_length())
    found = [
        Advice("task=relight_indirect", f"{share.shown} of the light is indirect"),
        Advice("method=wavelet_neural", f"{rank.shown} {rank.about}: more than a few bands can say"),
        Advice(f"method.wavelets={count}", f"{wavelets.shown} {wavelets.about}"),
        Advice(
            f"method.grid.log2_table={table}",
            f"{cells.shown} {cells.about}: no fine cell shares its features",
        ),
    ]
    mirror = needs["share/mirror"]
    if (mirror.value or 0.0) >= MIRRORS:
        found.append(
            Advice("method.secondary.roughness=0.24", f"{mirror.shown} {mirror.about}: networks blur them")
        )
    return found


def for_direct(needs: dict[str, Need]) -> list[Advice]:
    bands = needs["transfer/bands"]
    order = int(bands.value if bands.value is not None else bands.most or 1)
    return [
        Advice("task=relight_direct", "the task that was asked for"),
        Advice(f"task.order={order}", f"{bands.shown} {bands.about}"),
        Advice(
            "method=learnt_sh", "the smallest that stores transfer; texture_prt where memory does not count"
        ),
        Advice("method.neurons=auto", "fits the sizes of its ladder until one is good enough"),
    ]


def for_lightmaps(needs: dict[str, Need]) -> list[Advice]:
    rank = needs["lightmaps/rank"]
    elements = int(rank.value if rank.value is not None else rank.most or 1)
    return [
        Advice("task=local_lights", "the task that was asked for"),
        Advice("method=svd_transfer", f"{rank.shown} {rank.about}"),
        Advice(f"method.basis={elements}", "as many elements as the lightmaps have patterns"),
    ]


def for_animation(needs: dict[str, Need]) -> list[Advice]:
    change = {name.partition("/")[2]: float(need.value or 0.0) for name, need in needs.items()}
    idle = [name for name, value in change.items() if value < NOTHING]
    small = [name for name, value in change.items() if NOTHING <= value < LITTLE]
    found = [
        Advice(
            "task=animate", f"{len(change)} variables, of which {len(change) - len(idle)} change the image"
        )
    ]
    found.append(Advice("method=dynamic_radiosity", "the method for scenes that move"))
    if idle:
        found.append(
            Advice(
                f"method.ignored=[{','.join(idle)}]",
                f"each changes the image by less than {NOTHING:.1%}: no planes",
            )
        )
    if small and len(small) + len(idle) == len(change):
        reason = f"{', '.join(small)} change the image by less than {LITTLE:.0%}: coarse planes hold that"
        found.append(Advice("method.planes.levels=2", reason))
    return found


RULES: dict[str, Callable[[dict[str, Need]], list[Advice]]] = {
    "relight_indirect": for_relighting,
    "relight_direct": for_direct,
    "local_lights": for_lightmaps,
    "animate": for_animation,
}
