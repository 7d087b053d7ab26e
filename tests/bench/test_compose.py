import pytest
from fakes import CHOICE, write_conf

from prt.bench import compose as composing
from prt.bench.build import build
from prt.bench.compose import compose
from prt.errors import PrtError


@pytest.fixture(autouse=True)
def own_conf(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CONF_DIRS", str(write_conf(tmp_path / "conf")))


def test_everything_is_resolved_and_named():
    cfg = compose(CHOICE)
    assert cfg.task.resolution == 2 and cfg.lighting.resolution == 2
    assert compose([*CHOICE, "budget=laptop"]).task.resolution == 4
    assert dict(cfg.choice) == {
        "task": "fake",
        "scene": "fake",
        "lighting": "fake",
        "method": "fake",
        "budget": "smoke",
    }
    assert cfg.device in ("cpu", "cuda")
    assert "hydra" not in cfg
    assert compose(CHOICE) == cfg


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("method.widht=3", "unknown setting 'method.widht'; did you mean method.width"),
        ("width=3", "unknown setting 'width'; did you mean method.width"),
        ("methd=fake", "unknown setting 'methd'; did you mean method"),
        ("sed=1", "unknown setting 'sed'; did you mean seed"),
        ("run.checkpoint_second=3", "did you mean run.checkpoint_seconds"),
        ("method=fakee", "method=fakee does not exist; did you mean fake.*choose from .*fake, "),
        ("budget=huge", "budget=huge does not exist.*gpu, laptop, paper, smoke"),
        ("budget=paper", "task.resolution: budget=paper has no value here; choose from smoke, laptop"),
        ("foo", "cannot read 'foo': an override is key=value"),
        ("scene=fake,fake2", "add -m"),
        ("+foo=1", r"\+foo: nothing reads this setting"),
        ("+run.foo=1", r"\+run.foo: nothing reads this setting"),
        ("~seed", "seed is missing"),
        ("seed=-1", "seed=-1 must be an integer of at least 0"),
        ("seed=one", "seed='one' must be an integer"),
        ("device=tpu", "device='tpu' is not one of auto, cpu, cuda"),
        ("run.checkpoint_seconds=never", "run.checkpoint_seconds='never' must be a number"),
        ("run.repetitions=3", "run.repetitions=3 must be an integer of at least 30"),
        ("run.denoise=maybe", "run.denoise='maybe' must be true or false"),
        ("run.metrics=[psnr,snr]", "unknown metric 'snr'"),
        ("method.width=[3", r"cannot read 'method.width=\[3'"),
    ],
)
def test_a_mistake_is_one_line_that_helps(override, message):
    with pytest.raises(PrtError, match=message) as caught:
        compose([*CHOICE, override])
    assert "\n" not in str(caught.value)


def test_new_settings_reach_the_constructor_or_are_refused():
    assert build(compose([*CHOICE, "+method.shape=2"]), "method").shape == 2
    with pytest.raises(
        PrtError, match="method.shap is not a setting of FakeMethod; did you mean shape.*it takes steps"
    ):
        build(compose([*CHOICE, "+method.shap=2"]), "method")
    with pytest.raises(PrtError, match="missing a required argument: 'resolution'"):
        build(
            compose([*CHOICE, "~task.resolution", "lighting.resolution=2"]), "task", scene=None, lighting=None
        )


def test_a_target_that_cannot_be_imported_is_one_line():
    with pytest.raises(PrtError, match="method._target_=fakes.Nowhere cannot be built"):
        build(compose([*CHOICE, "method=nowhere"]), "method")


def test_a_users_own_folder_adds_choices(tmp_path):
    assert "fake" in composing.choices("method")
    assert "laptop" in composing.choices("budget")


def test_a_conf_folder_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setenv("PRT_CONF_DIRS", str(tmp_path / "nothing"))
    with pytest.raises(PrtError, match="nothing is no folder"):
        compose(CHOICE)
    monkeypatch.setenv("PRT_CONF", str(tmp_path))
    with pytest.raises(PrtError, match="set PRT_CONF"):
        composing.conf_folder()
