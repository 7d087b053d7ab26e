import hashlib

import numpy as np
import pytest
import torch

from prt.errors import PrtError
from prt.light.cubemap import mean_radiance
from prt.light.environments import EnvironmentSet
from prt.light.hdri import HdriFolders
from prt.paths import data_folder


def write_map(path, value):
    """A small EXR: grey ``value`` with a bright spot whose place depends on the name."""
    import OpenEXR

    pixels = np.full((16, 32, 3), value, np.float32)
    place = int(hashlib.sha256(path.stem.encode()).hexdigest(), 16)
    pixels[place % 16, place // 16 % 32] = 50.0
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}).write(str(path))


@pytest.fixture
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "cache"))
    for folder, count in (("indoor", 10), ("outdoor", 4)):
        (tmp_path / folder).mkdir()
        for i in range(count):
            write_map(tmp_path / folder / f"{folder}{i}.exr", 0.5 + i)
    return tmp_path


def make(folders, **settings):
    defaults = {"resolution": 4, "test_count": 4}
    train, test = [str(folders / "indoor")], [str(folders / "indoor"), str(folders / "outdoor")]
    return HdriFolders(**{**defaults, "train_folders": train, "test_folders": test, **settings})


def test_split_is_by_source_map_and_half_of_the_tests_are_outdoor(folders):
    lights = make(folders)
    assert isinstance(lights, EnvironmentSet)
    names, radiance = lights.train()
    tests, test_radiance = lights.test()
    assert len(names) == 8 * 3 * 2 and radiance.shape == (48, 6, 4, 4, 3)
    assert len(set(names)) == len(names)
    assert test_radiance.shape == (4, 6, 4, 4, 3)
    assert [name[:-1] for name in tests] == ["indoor", "outdoor"] * 2
    assert not {name.split("_")[0] for name in names} & set(tests)


def test_the_split_is_deterministic_and_follows_the_seed(folders):
    assert make(folders).test_maps == make(folders).test_maps
    assert len({tuple(make(folders, seed=seed).test()[0]) for seed in range(4)}) > 1


def test_the_training_split_does_not_depend_on_the_number_of_tests(folders):
    assert make(folders, test_count=2).train_maps == make(folders, test_count=6).train_maps
    assert make(folders, test_count=2).fingerprint() == make(folders, test_count=6).fingerprint()


def test_unit_mean_radiance_and_prior(folders):
    lights = make(folders, train_count=60)
    names, radiance = lights.train()
    assert len(names) == 60 and names[-1] == "mix0011"
    torch.testing.assert_close(mean_radiance(radiance).mean(-1), torch.ones(60), rtol=1e-4, atol=0)
    torch.testing.assert_close(lights.prior(), radiance.mean(0))
    own = make(folders, normalise=False).train()[1]
    assert mean_radiance(own).mean(-1).max() > 5


def test_fewer_lights_than_maps_keeps_unrotated_ones(folders):
    names, radiance = make(folders, train_count=5).train()
    assert len(radiance) == 5 and not any("yaw" in name or "mirror" in name for name in names)


def test_lamps_are_further_training_lights_and_no_test_light(folders):
    plain, lit = make(folders, train_count=10), make(folders, train_count=10, lamps=3)
    names, radiance = lit.train()
    assert names[:10] == plain.train()[0] and names[10:] == ["lamp0000", "lamp0001", "lamp0002"]
    assert len(radiance) == 13 and torch.equal(radiance[:10], plain.train()[1])
    torch.testing.assert_close(mean_radiance(radiance).mean(-1), torch.ones(13), rtol=1e-4, atol=0)
    assert torch.equal(lit.test()[1], plain.test()[1])
    assert lit.fingerprint() != plain.fingerprint() and "3 with a lamp" in lit.describe()


def test_read_again_from_the_cache(folders):
    first = make(folders).train()[1]
    before = sorted(path.name for path in (folders / "cache" / "environments").iterdir())
    assert torch.equal(make(folders).train()[1], first)
    assert sorted(path.name for path in (folders / "cache" / "environments").iterdir()) == before


def test_a_changed_map_changes_the_fingerprint(folders):
    before = make(folders).fingerprint()
    write_map(make(folders).train_maps[0], 99.0)
    assert make(folders).fingerprint() != before


def test_clamp_limits_the_brightest_texel(folders):
    loose, tight = make(folders).train()[1], make(folders, clamp=1.5).train()[1]
    assert tight.amax() < 0.7 * loose.amax()


def test_a_users_own_file_or_folder_is_the_test(folders):
    own = folders / "mine"
    own.mkdir()
    write_map(own / "kitchen.exr", 1.0)
    write_map(own / "attic.exr", 1.0)
    assert make(folders, path=str(own)).test()[0] == ["attic", "kitchen"]
    assert make(folders, path=str(own / "attic.exr")).test()[0] == ["attic"]
    with pytest.raises(PrtError, match="lighting.path"):
        make(folders, path=str(folders / "nowhere.exr")).test()


def test_a_bad_map_is_refused_by_name_or_mended(folders):
    import OpenEXR

    pixels = np.ones((16, 32, 3), np.float32)
    pixels[3, 3, 1] = np.nan
    path = folders / "broken.exr"
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": pixels}).write(str(path))
    with pytest.raises(PrtError, match="broken.*1 NaN"):
        make(folders, path=str(path)).test()
    with pytest.warns(UserWarning, match="broken"):
        assert make(folders, path=str(path), mend=True).test()[1].isfinite().all()


def test_a_black_map_stays_black(folders):
    import OpenEXR

    path = folders / "night.exr"
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.zeros((16, 32, 3), np.float32)}).write(str(path))
    assert make(folders, path=str(path)).test()[1].sum() == 0


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"test_count": 7}, "only 6 maps"),
        ({"test_count": 0}, "test_count=0"),
        ({"resolution": 12}, "power of two"),
        ({"clamp": 0.5}, "clamp=0.5"),
        ({"held_out": 1.5}, "held_out=1.5"),
        ({"train_count": 0}, "train_count=0"),
        ({"rotations": []}, "rotations"),
        ({"lamps": -1}, "lamps=-1"),
    ],
)
def test_wrong_settings_are_errors(folders, settings, message):
    with pytest.raises(PrtError, match=message):
        make(folders, **settings).test()


def test_missing_data_says_what_to_set(monkeypatch):
    monkeypatch.delenv("PRT_DATA", raising=False)
    with pytest.raises(PrtError, match="PRT_DATA"):
        HdriFolders(resolution=4).train()


def test_the_photographed_maps(tmp_path, monkeypatch):
    if data_folder() is None:
        pytest.skip("PRT_DATA is not set: no photographed environment maps")
    monkeypatch.setenv("PRT_CACHE", str(tmp_path))
    lights = HdriFolders(resolution=8, train_count=4, test_count=8)
    names, radiance = lights.test()
    trained = {path.stem for path in lights.train_maps}
    assert len(names) == 8 and not trained & set(names)
    torch.testing.assert_close(mean_radiance(radiance).mean(-1), torch.ones(8), rtol=1e-4, atol=0)
