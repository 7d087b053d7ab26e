from pathlib import Path

import pytest

from prt.errors import PrtError
from prt.paths import cache_folder, data_file, data_folder


def test_data_folder_unset_or_blank_is_none(monkeypatch):
    monkeypatch.delenv("PRT_DATA", raising=False)
    assert data_folder() is None
    monkeypatch.setenv("PRT_DATA", "  ")
    assert data_folder() is None


def test_data_file_is_found_below_the_folder(monkeypatch, tmp_path):
    (tmp_path / "hdri").mkdir()
    (tmp_path / "hdri" / "sky.hdr").write_bytes(b"x")
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    assert data_file("hdri/sky.hdr") == tmp_path / "hdri" / "sky.hdr"


def test_unset_data_folder_is_one_line_that_says_what_to_do(monkeypatch):
    monkeypatch.delenv("PRT_DATA", raising=False)
    with pytest.raises(PrtError) as caught:
        data_file("meshes/lion.ply")
    message = str(caught.value)
    assert "\n" not in message
    assert "meshes/lion.ply" in message and "PRT_DATA" in message and "https://" in message


def test_missing_data_file_says_where_it_was_expected(monkeypatch, tmp_path):
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    with pytest.raises(PrtError) as caught:
        data_file("meshes/lion.ply")
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "meshes" / "lion.ply") in str(caught.value)


def test_cache_folder_order_of_preference(monkeypatch, tmp_path):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "mine"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.setenv("PRT_CACHE", "~/somewhere")
    assert cache_folder() == Path.home() / "somewhere"
    monkeypatch.delenv("PRT_CACHE")
    assert cache_folder() == tmp_path / "xdg" / "prt"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "prt"
