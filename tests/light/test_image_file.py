import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.light.image_file import read_image, read_rgbe

IMAGE = np.array([[[1.0, 0.5, 0.25], [0.0, 0.0, 0.0]], [[3.6e5, 1e3, 10.0], [1e-3, 2e-3, 4e-3]]])


def rgbe_bytes(image: np.ndarray) -> np.ndarray:
    peak = image.max(-1)
    exponent = np.where(peak > 0, np.floor(np.log2(np.maximum(peak, 1e-30))) + 1, -128).astype(int)
    mantissa = np.floor(image / 2.0 ** exponent[..., None] * 256)
    return np.concatenate([mantissa, (exponent + 128)[..., None]], -1).astype(np.uint8)


def header(H: int, W: int, extra: str = "") -> bytes:
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{extra}\n-Y {H} +X {W}\n".encode()


def encoded(image: np.ndarray) -> bytes:
    """Run-length encoding: runs of up to 127 where a byte repeats, else literals of one."""
    H, W = image.shape[:2]
    out = bytearray(header(H, W))
    for line in rgbe_bytes(image):
        out += bytes([2, 2, W >> 8, W & 255])
        for channel in line.T:
            x = 0
            while x < W:
                run = 1
                while x + run < W and run < 127 and channel[x + run] == channel[x]:
                    run += 1
                out += bytes([128 + run, channel[x]]) if run > 1 else bytes([1, channel[x]])
                x += run
    return bytes(out)


def test_flat_scanlines():
    blob = header(2, 2) + rgbe_bytes(IMAGE).tobytes()
    pixels = read_rgbe(blob)
    peak = IMAGE.max(-1, keepdims=True)
    assert (np.abs(pixels - IMAGE) <= peak / 128).all()
    assert (pixels[0, 1] == 0).all()


def test_run_length_scanlines():
    image = np.random.default_rng(0).random((5, 40, 3)) ** 4
    image[:, 10:30] = 2.0
    pixels = read_rgbe(encoded(image))
    assert (np.abs(pixels - image) <= image.max(-1, keepdims=True) / 128).all()
    assert (pixels[:, 10:30] == 2.0).all()


def test_exposure_in_the_header_divides():
    blob = header(2, 2, "EXPOSURE=4\n") + rgbe_bytes(IMAGE).tobytes()
    np.testing.assert_allclose(read_rgbe(blob) * 4, read_rgbe(header(2, 2) + rgbe_bytes(IMAGE).tobytes()))


@pytest.mark.parametrize("cut", [3, 45, 60, 200])
def test_a_cut_file_is_one_line(tmp_path, cut):
    path = tmp_path / "cut.hdr"
    path.write_bytes(encoded(np.random.default_rng(1).random((8, 40, 3)))[:cut])
    with pytest.raises(PrtError, match="cut.hdr"):
        read_image(path)


def test_exr_round_trip(tmp_path):
    import OpenEXR

    pixels = np.random.default_rng(2).random((4, 8, 3)).astype(np.float32) * 1e6
    path = tmp_path / "map.exr"
    OpenEXR.File(
        {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": pixels}
    ).write(str(path))
    assert torch.equal(read_image(path), torch.from_numpy(pixels))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(PrtError, match="map.exr"):
        read_image(path)


def test_unknown_suffix_and_missing_file(tmp_path):
    with pytest.raises(PrtError, match=".hdr, .exr"):
        read_image(tmp_path / "map.jpg")
    with pytest.raises(PrtError, match="not found"):
        read_image(tmp_path / "map.hdr")
