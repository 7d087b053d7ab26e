"""The wavelet factors W_m[k] of Raghavan 2023 (Eq. 6): a texture over the cubemap's Haar coefficients.

The paper learns one vector per wavelet. A step of training sees a few hundred of many thousand wavelets, so
the vectors of the fine ones are visited rarely and learn slowly. Yet neighbouring wavelets of one scale and
orientation see transport that varies smoothly. With ``shared`` a wavelet is given the sum of one vector of
its own and of vectors it shares with its neighbours, in blocks that double in size up to a whole face.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn


class WaveletTexture(nn.Module):
    """M values for each of 6 R R wavelets.

    Args:
        resolution: R, a power of two.
        terms: M.
        shared: also learn vectors for blocks of neighbouring wavelets.
    """

    def __init__(self, resolution: int, terms: int, shared: bool):
        super().__init__()
        self.wavelets = 6 * resolution**2
        owners = block_owners(resolution) if shared else torch.arange(self.wavelets)[:, None]
        rows = int(owners.max()) + 1
        # the last row stays zero: it fills up wavelets that belong to fewer blocks
        padded = torch.where(owners < 0, rows, owners)
        self.register_buffer("owners", padded, persistent=False)
        blocks = (owners >= 0).sum(dim=1).float().mean()
        self.table = nn.Parameter(torch.randn(rows, terms) / blocks.sqrt())

    def forward(self, k: Int[Tensor, "K"]) -> Float[Tensor, "K M"]:
        """The vectors of the wavelets k."""
        padded = torch.cat([self.table, self.table.new_zeros(1, self.table.shape[1])])
        return padded[self.owners[k]].sum(dim=1)


def block_owners(resolution: int) -> Int[Tensor, "T B"]:
    """For every wavelet the table rows of the blocks it belongs to, its own first; -1 where there are fewer.

    Wavelets share a block when they lie on one face, have one scale and orientation, and fall into the same
    square of 2, 4, 8, ... wavelets a side.
    """
    index = torch.arange(6 * resolution**2)
    face, row, column = index // resolution**2, index // resolution % resolution, index % resolution
    places = torch.ones_like(index)
    for power in range(1, resolution.bit_length() - 1):
        places = torch.where(torch.maximum(row, column) >= 2**power, 2**power, places)
    orientation = (row >= places).long() * 2 + (column >= places).long()
    kind = (face * resolution + places) * 4 + orientation
    columns, rows = [index], len(index)
    size = 2
    while size <= resolution // 2:
        inside = (row % places) // size * resolution + (column % places) // size
        member = places >= size
        key = (kind * resolution**2 + inside)[member]
        found, place = torch.unique(key, return_inverse=True)
        owner = torch.full_like(index, -1)
        owner[member] = place + rows
        rows += len(found)
        columns.append(owner)
        size *= 2
    return torch.stack(columns, dim=1)
