"""Basis and transfer matrix from pairs of direct and indirect light (Belcour 2022, sections 3 and 4.2).

Vectors are rows here, columns in the paper. With N vectors of direct light D (N, M) and of indirect light
I (N, T), both divided by the norms of D's rows:

    I - mean = C U          U: orthonormal rows, from the eigenvectors of the N x N Gram matrix    (Eq. 7, 8)
    c = d (D' D + lambda)^-1 D' C      the coefficients of new direct light d                   (Eq. 13, 14)
    y = |d| (mean + c / |d| U)                                                             (section 4.2)
"""

import dataclasses

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prt.errors import PrtError

NORMS = ("l2", "l1", "none")
#: eigenvalues below this share of the largest are rounding
RANK = 1e-10
#: direct vectors of less than this share of the brightest one's norm say nothing
BLACK = 1e-6


@dataclasses.dataclass
class Vectors:
    """Vectors of one basis, with the configuration and the channel (0 where they are not apart) of each."""

    direct: Float[Tensor, "N M"]
    indirect: Float[Tensor, "N T"]
    configuration: Int[Tensor, "N"]
    channel: Int[Tensor, "N"]

    @staticmethod
    def joined(parts: list["Vectors"]) -> "Vectors":
        """All of them in one list."""
        names = [field.name for field in dataclasses.fields(Vectors)]
        return Vectors(*(torch.cat([getattr(part, name) for part in parts]) for name in names))


@dataclasses.dataclass
class Pairs:
    """Normalised pairs: N vectors of M measurements and T texels; both were divided by ``norm``.

    ``row`` says which of the given pairs each is: black ones are left out.
    """

    direct: Float[Tensor, "N M"]
    indirect: Float[Tensor, "N T"]
    norm: Float[Tensor, "N"]
    row: Int[Tensor, "N"]

    def part(self, chosen: Bool[Tensor, "N"]) -> "Pairs":
        """Some of them."""
        return Pairs(self.direct[chosen], self.indirect[chosen], self.norm[chosen], self.row[chosen])


@dataclasses.dataclass
class SvdBasis:
    """All that the pairs span; :meth:`elements` of it are kept at run time.

    Attributes:
        mean: of the normalised indirect vectors.
        vectors: orthonormal, most important first.
        eigenvalues: of the Gram matrix, in their order.
        coefficients: of the N vectors.
    """

    mean: Float[Tensor, "T"]
    vectors: Float[Tensor, "K T"]
    eigenvalues: Float[Tensor, "K"]
    coefficients: Float[Tensor, "N K"]


def norm_of(direct: Float[Tensor, "N M"], kind: str) -> Float[Tensor, "N"]:
    """The norm that pairs are divided by and that the mean is scaled with.

    ``l2``: Euclidean (section 4.2); ``l1``: sum over the root of M, which is l2 for an even vector; ``none``:
    1, and 0 for a black vector.
    """
    if kind == "l1":
        return direct.abs().sum(dim=1) / direct.shape[1] ** 0.5
    size = direct.norm(dim=1)
    return size if kind == "l2" else (size > 0).to(size.dtype)


def normalised(direct: Float[Tensor, "N M"], indirect: Float[Tensor, "N T"], kind: str = "l2") -> Pairs:
    """Both divided by a norm of the direct vector; pairs without direct light are left out.

    Raises:
        PrtError: if all are black, or a value is not finite.
    """
    if not (bool(direct.isfinite().all()) and bool(indirect.isfinite().all())):
        raise PrtError("the baked database holds NaN or infinite values; delete the cache and bake again")
    norm = norm_of(direct, kind)
    lit = norm > BLACK * norm.max().clamp_min(1e-30)
    if not bool(lit.any()):
        raise PrtError(
            "every training configuration is black at every measurement point: no transfer can be learnt; "
            "check that the scenario's lights reach the asset (lighting.distance, place, aim) or raise "
            "method.points"
        )
    scale = norm[lit, None]
    return Pairs(direct[lit] / scale, indirect[lit] / scale, norm[lit], lit.nonzero()[:, 0])


def extract(indirect: Float[Tensor, "N T"]) -> SvdBasis:
    """Mean and orthonormal basis from the eigenvectors of the Gram matrix (Turk and Pentland 1991).

    Products are summed in float64: the small eigenvalues are differences of large ones.
    """
    mean = indirect.mean(dim=0)
    centred = indirect - mean
    gram = torch.zeros((len(indirect), len(indirect)), dtype=torch.float64)
    for part in centred.split(1 << 16, dim=1):  # not all of it in float64 at once
        part = part.double()
        gram += part @ part.T
    values, turned = torch.linalg.eigh(gram)
    values, turned = values.flip(0), turned.flip(1)
    kept = int((values > RANK * values[0].clamp_min(1e-300)).sum()) if len(values) else 0
    values, turned = values[:kept], turned[:, :kept]
    vectors = (turned / values.sqrt()).float().T @ centred
    return SvdBasis(mean, vectors, values, turned * values.sqrt())


def transfer_matrix(
    direct: Float[Tensor, "N M"], coefficients: Float[Tensor, "N K"], regularisation: float | None
) -> Float[Tensor, "M K"]:
    """From direct light to coefficients: pseudo-inverse (Eq. 13) or Tikhonov regularisation (Eq. 14).

    Args:
        direct: rows of unit norm, which gives lambda a scale.
        regularisation: lambda; None or 0 for the pseudo-inverse.

    Raises:
        PrtError: for a negative lambda.
    """
    d, c = direct.double(), coefficients.double()
    if regularisation is not None and not 0 <= regularisation < float("inf"):
        raise PrtError(f"method.regularisation={regularisation} must be at least 0, or null (lambda, Eq. 14)")
    if not regularisation:
        return torch.linalg.pinv(d) @ c
    small = len(d) < d.shape[1]  # the same solution from the smaller of the two Gram matrices
    gram = d @ d.T if small else d.T @ d
    gram.diagonal().add_(regularisation)
    return d.T @ torch.linalg.solve(gram, c) if small else torch.linalg.solve(gram, d.T @ c)


def condition(direct: Float[Tensor, "N M"], regularisation: float | None) -> float:
    """Condition number of the smaller Gram matrix of the direct vectors, lambda on its diagonal."""
    values = torch.linalg.svdvals(direct.double()).square()
    added = regularisation or 0.0
    return float((values[0] + added) / (values[-1] + added).clamp_min(1e-300))


def error_curve(
    basis: SvdBasis, transfer: Float[Tensor, "M K"], held_out: Pairs
) -> tuple[Float[Tensor, "K1"], Float[Tensor, "K1"]]:
    """Relative error on pairs the basis has not seen, for 1, 2, ... elements (the first is the mean).

    Returns:
        Root of the summed squared error over that of the vectors: with transferred coefficients, and with
        those of the projection, which is the bound.
    """
    weight = held_out.norm.double()[:, None]
    left = (held_out.indirect - basis.mean).double()
    best = left @ basis.vectors.double().T * weight
    found = held_out.direct.double() @ transfer * weight
    whole = (held_out.indirect.double() * weight).square().sum()
    start = (left * weight).square().sum()
    bound = start - torch.cat([start.new_zeros(1), best.square().sum(0).cumsum(0)])
    error = bound + torch.cat([start.new_zeros(1), (best - found).square().sum(0).cumsum(0)])
    return (error.clamp_min(0) / whole).sqrt(), (bound.clamp_min(0) / whole).sqrt()
