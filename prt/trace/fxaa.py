"""Fast approximate anti-aliasing of a finished image: jagged edges are blurred along themselves."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prt.errors import PrtError

#: of red, green and blue in perceived brightness (Rec. 601, as in the paper's implementation)
LUMA = (0.299, 0.587, 0.114)
#: a pixel is at an edge where the luma around it spans more than this share of its largest, and more than
#: this in all (FXAA 3.11: "high quality" and "visible limit"); elsewhere it is not touched
CONTRAST, DARKEST = 1 / 8, 1 / 32
#: keeps the direction across noise from growing: share of the mean luma, and at least
REDUCE, LEAST_REDUCE = 1 / 8, 1 / 128


def fxaa(image: Float[Tensor, "H W 3"], exposure: float = 1.0, radius: float = 4.0) -> Float[Tensor, "H W 3"]:
    """The image with its edges smoothed (Lottes 2009, FXAA), as a post-process of one sample a pixel.

    Su 2024 (section 5, "Antialiasing") uses DesLauriers' glsl-fxaa with a kernel radius of 4 pixels. It takes
    the direction of an edge from the luma of the four diagonal neighbours, and averages taps along it: two at
    a sixth of the kernel and, unless that leaves the range of luma around the pixel, two more at its ends.
    That pixels without contrast are left alone is FXAA 3.11's.

    Edges are looked for as a viewer sees them, in the luma of ``image * exposure``, clipped and sRGB-encoded;
    linear radiance is what is blended, as supersampling would.

    Args:
        image: finite linear radiance.
        exposure: the factor before clipping to what a display shows.
        radius: the largest reach of the kernel, pixels: ends are at most ``radius / 2`` from the middle along
            x and along y.

    Raises:
        PrtError: for a radius or exposure that is not positive.
    """
    for name, value in (("exposure", exposure), ("radius", radius)):
        if not value > 0:
            raise PrtError(f"anti-aliasing {name}={value!r} must be above 0")
    height, width, _ = image.shape
    if not height or not width:
        return image.clone()
    luma = shown_luma(image, exposure)
    edge, direction, low, high = edges(luma, radius)
    row, column = edge.nonzero(as_tuple=True)
    middle = torch.stack([column, row], dim=1).to(image.dtype)

    near = (sampled(image, middle - direction / 6) + sampled(image, middle + direction / 6)) / 2
    far = (sampled(image, middle - direction / 2) + sampled(image, middle + direction / 2)) / 4 + near / 2
    reached = shown_luma(far, exposure)
    inside = (reached >= low) & (reached <= high)
    out = image.clone()
    out[row, column] = torch.where(inside[:, None], far, near)
    return out


def shown_luma(radiance: Float[Tensor, "*N 3"], exposure: float) -> Float[Tensor, "*N"]:
    """Luma of the sRGB-encoded radiance, 0 to 1; whatever is too bright for a display is white."""
    shown = (radiance * exposure).clamp(0, 1)
    curve = torch.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown.clamp_min(1e-4) ** (1 / 2.4) - 0.055)
    red, green, blue = curve.unbind(-1)
    return LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue


def edges(
    luma: Float[Tensor, "H W"], radius: float
) -> tuple[Bool[Tensor, "H W"], Float[Tensor, "E 2"], Float[Tensor, "E"], Float[Tensor, "E"]]:
    """Which pixels are at an edge; for those the whole kernel (x, y in pixels) and the range of luma around.

    The range is over the pixel and its diagonal neighbours; pixels beyond the border are like those at it.
    """
    height, width = luma.shape
    padded = torch.nn.functional.pad(luma[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]

    def moved(down: int, right: int) -> Tensor:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    corners = torch.stack([moved(-1, -1), moved(-1, 1), moved(1, -1), moved(1, 1)])
    low = torch.minimum(corners.amin(0), luma)
    high = torch.maximum(corners.amax(0), luma)
    edge = high - low > (CONTRAST * high).clamp_min(DARKEST)

    north_west, north_east, south_west, south_east = corners[:, edge]
    # perpendicular to the gradient
    x = (south_west + south_east) - (north_west + north_east)
    y = (north_west + south_west) - (north_east + south_east)
    reduce = (REDUCE * corners[:, edge].mean(0)).clamp_min(LEAST_REDUCE)
    # The shorter side becomes a pixel: an edge that is nearly along an axis has steps many pixels long.
    scale = torch.minimum(x.abs(), y.abs()) + reduce
    direction = (torch.stack([x, y], dim=1) / scale[:, None]).clamp(-radius, radius)
    return edge, direction, low[edge], high[edge]


def sampled(image: Float[Tensor, "H W 3"], place: Float[Tensor, "E 2"]) -> Float[Tensor, "E 3"]:
    """The image between pixels, bilinearly; places (x, y) are in pixels, those outside at the border."""
    height, width, _ = image.shape
    size = torch.tensor([width, height], device=image.device)
    place = torch.minimum(place.clamp_min(0), size - 1.0)
    first = place.long()
    second = torch.minimum(first + 1, size - 1)
    part = (place - first)[:, :, None]
    flat = image.reshape(-1, 3)

    def pixels(x: Tensor, y: Tensor) -> Tensor:
        return flat.index_select(0, y * width + x)

    (x0, y0), (x1, y1) = first.T, second.T
    upper = torch.lerp(pixels(x0, y0), pixels(x1, y0), part[:, 0])
    lower = torch.lerp(pixels(x0, y1), pixels(x1, y1), part[:, 0])
    return torch.lerp(upper, lower, part[:, 1])
