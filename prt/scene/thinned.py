"""Some of a mesh's vertices that stand for all, where what is stored at one is too large for each."""

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prt.scene.lightmap_points import TriangleMesh

#: how much a turn of the normal by a radian counts, in spacings
TURN = 1.0
#: kept vertices a vertex is interpolated from at most, and how far off they may be, in spacings
SUPPORT, RADIUS = 6, 2.0


@dataclasses.dataclass
class Thinned:
    """The S vertices that are kept of V, and how each of the V is interpolated from them.

    Attributes:
        kept: numbers of the vertices, ascending.
        rows: of the kept ones, which each vertex is interpolated from.
        weights: of sum 1; a kept vertex has itself alone.
    """

    kept: Int[Tensor, "S"]
    rows: Int[Tensor, "V C"]
    weights: Float[Tensor, "V C"]


def thinned(mesh: TriangleMesh, spacing: float) -> Thinned:
    """Keep vertices so that none lies within ``spacing`` (world units) of another, and none further from all.

    Distance counts places and normals together, so that more are kept where a surface bends and those of its
    two sides, or of two shapes, never stand for each other. Vertices are tried in random order (dart
    throwing); the weights are Shepard's in the form of Franke and Nielson 1980, ``((R - d) / (R d))^2``.

    Args:
        spacing: 0 keeps every vertex.
    """
    from scipy.spatial import cKDTree

    many = len(mesh.position)
    if spacing <= 0:
        return Thinned(torch.arange(many), torch.arange(many)[:, None], torch.ones((many, 1)))
    shape = torch.full((many, 1), -1.0)  # of vertices that no triangle uses
    shape[mesh.face] = mesh.shape[:, None, None].float()
    # shapes are further apart than any vertex is looked for
    place = torch.cat([mesh.position / spacing, TURN * mesh.normal, 2 * RADIUS * shape], dim=1).double()
    tree = cKDTree(place.numpy())
    covered = torch.zeros(many, dtype=torch.bool).numpy()
    kept = []
    for vertex in torch.randperm(many, generator=torch.Generator().manual_seed(0)).tolist():
        if not covered[vertex]:
            kept.append(vertex)
            covered[tree.query_ball_point(place[vertex].numpy(), 1.0)] = True
    chosen = torch.tensor(kept).sort().values
    distance, rows = cKDTree(place[chosen].numpy()).query(place.numpy(), k=min(SUPPORT, len(kept)))
    distance = torch.from_numpy(distance).view(many, -1)
    weights = ((RADIUS - distance).clamp_min(0) / (RADIUS * distance.clamp_min(1e-6))) ** 2
    weights = (weights / weights.sum(1, keepdim=True)).float()
    return Thinned(chosen, torch.from_numpy(rows).view(many, -1), weights)
