"""C++ that is compiled at first use: kept, compiled anew when it changes, and errors in one line."""

import pytest
import torch

from prt.errors import PrtError
from prt.nn import compiled
from prt.nn.hashgrid import HashGrid
from prt.nn.hashgrid_compiled import lookup_compiled

needs_compiler = pytest.mark.skipif(compiled.find_compiler() is None, reason="no C++ compiler")


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "small.cpp"
    path.write_text('extern "C" int seven() { return 7; }')
    return path


@needs_compiler
def test_a_source_is_compiled_once(source, monkeypatch):
    assert compiled.library(source).seven() == 7
    monkeypatch.setattr(compiled, "build", None)
    compiled.library.cache_clear()
    assert compiled.library(source).seven() == 7


@needs_compiler
def test_a_changed_source_has_another_key(source):
    compiler = compiled.find_compiler()
    before = compiled.key(source, compiler)
    source.write_text('extern "C" int seven() { return 8; }')
    assert compiled.key(source, compiler) != before


@needs_compiler
def test_a_mistake_in_the_source_is_one_line_and_leaves_nothing(source, tmp_path):
    source.write_text("this is no C++")
    with pytest.raises(PrtError, match="cannot compile small.cpp: .*error.*method.kernel=auto") as caught:
        compiled.library(source)
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "cache" / "compiled").iterdir())


def test_no_compiler_is_said_so(source, monkeypatch):
    monkeypatch.setattr(compiled, "find_compiler", lambda: None)
    with pytest.raises(PrtError, match="small.cpp needs a C\\+\\+ compiler"):
        compiled.library(source)


@needs_compiler
@pytest.mark.parametrize("levels, features, log2_table", [(6, 2, 8), (5, 3, 8), (2, 4, 12)])
def test_the_compiled_lookup_equals_the_readable_one(levels, features, log2_table, own_cache, monkeypatch):
    grid = HashGrid(levels, features, log2_table, 4, 1.4, ((0.0, 0.0, 0.0), (1.0, 0.5, 1.0)))
    points = torch.rand((5000, 3), generator=torch.Generator().manual_seed(0)) * 1.2 - 0.1  # some outside
    with torch.no_grad():
        torch.nn.init.normal_(grid.table)
        expected = grid.forward_readable(points)
    for threads in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        assert (lookup_compiled(grid, points) - expected).abs().max() < 1e-5
    assert lookup_compiled(grid, points[:0]).shape == (0, grid.out_features)
