from prt.bench import doctor
from prt.errors import PrtError


def test_a_broken_requirement_changes_the_exit_status(monkeypatch, capsys):
    def fine():
        return [doctor.Finding("ok", "this", "1.0"), doctor.Finding("missing", "that", "get it there")]

    def broken_thing():
        raise PrtError("no usable\nLLVM; install one")

    monkeypatch.setattr(doctor, "CHECKS", {"first": fine})
    assert doctor.main() == 0
    out = capsys.readouterr().out
    assert "missing, not required: that" in out and "everything required works" in out
    monkeypatch.setattr(doctor, "CHECKS", {"first": fine, "second": broken_thing})
    assert doctor.main() == 1
    out = capsys.readouterr().out
    assert "no usable LLVM; install one" in out and "broken: broken thing" in out


def test_missing_data_says_what_is_expected_where(monkeypatch, tmp_path):
    monkeypatch.delenv("PRT_DATA", raising=False)
    (finding,) = doctor.data()
    assert finding.state == "missing" and "set PRT_DATA" in finding.detail
    (tmp_path / "hdri").mkdir()
    (tmp_path / "hdri" / "a.hdr").write_bytes(b"x")
    monkeypatch.setenv("PRT_DATA", str(tmp_path))
    states = {finding.what: finding.state for finding in doctor.data()}
    assert states == {
        "PRT_DATA": "ok",
        "hdri": "ok",
        "lpips": "missing",
        "meshes": "missing",
        "scenes": "missing",
    }


def test_a_cache_that_cannot_be_written_is_broken(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PRT_CACHE", str(tmp_path / "file"))
    (finding,) = doctor.guarded(doctor.cache)
    assert finding.state == "broken" and "set PRT_CACHE" in finding.detail


def test_the_glsl_renderer_is_named_or_missing_with_a_reason(monkeypatch):
    from prt.methods import blend_shader

    monkeypatch.setattr(blend_shader, "device_name", lambda: "a renderer")
    (finding,) = doctor.glsl()
    assert (finding.state, finding.detail) == ("ok", "works with a renderer")

    def fail():
        raise PrtError("no EGL; install it")

    monkeypatch.setattr(blend_shader, "device_name", fail)
    (finding,) = doctor.glsl()
    assert (finding.state, finding.detail) == ("missing", "no EGL; install it")


def test_packages_of_this_environment_are_found():
    states = {finding.what: finding.state for finding in doctor.packages()}
    assert states["torch"] == "ok" and states["python"] == "ok"
