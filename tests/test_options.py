"""The table of a training's options: every door takes them from it, and none lacks one without a reason."""

import inspect
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.builders import REPOSITORY, Run, printed, refused, run_python
from support.option_examples import EXAMPLES, beyond

from frog_blender import engine as frog
from frog_blender.cli.commands import _parser
from frog_blender.cli.train_command import _options_of
from frog_blender.engine.errors import FrogError
from frog_blender.engine.given_options import given_texts, training_options
from frog_blender.engine.options import OPTIONS, JobOptions, Resume, TrainingOptions, panel_options
from frog_blender.engine.recipes import Recipe, recipe
from frog_blender.engine.setting import OrNone, meanings_of
from frog_blender.engine.training.session.job import STORED, TrainingJob

WRONG: dict[str, list[Any]] = {
    "settings": [5, {"stpes_per_moment": 3}, {"head_width": -1}, {3: 4}],
    "key": [5, True, ["green"], "\n", "grey", "green,2"],
    "pixel_offsets": [5, [1], {"a": 1}, {"a": [1, math.nan]}, {"a": [1, 2, 3]}, {"a": [True, 1]}],
    "preview_camera": [5, "a\nb"],
}


def wrong(name: str) -> list[Any]:
    """What an option does not take: numbers and choices say it themselves."""
    is_optional = isinstance(OPTIONS[name].kind, OrNone)
    values = WRONG.get(name) or beyond(OPTIONS[name].plain_kind)
    return [value for value in values if not (is_optional and value is None)]


def by_command(*words: str) -> TrainingOptions:
    """What ``frog train`` makes of options."""
    return _options_of(_parser().parse_args(["train", "x", "--out", "x.frog", *words]))[0]


def test_every_door_is_asked_about_every_option() -> None:
    assert EXAMPLES.keys() == OPTIONS.keys()
    for option in OPTIONS.values():
        assert option.help and option.kind.accepts(option.default)
        assert option.unset if isinstance(option.kind, OrNone) else option.default is not None
        assert option.is_switch or option.items or option.placeholder or option.name == "method"
        assert option.label or option.not_in_panel
        value, words = EXAMPLES[option.name]
        assert option.kind.accepts(value) and value != option.default and bool(words) is not option.is_switch


def test_the_command_line_has_every_option(tmp_path: Path) -> None:
    assert by_command() == TrainingOptions()
    for name, (value, words) in EXAMPLES.items():
        flag, expected = OPTIONS[name].flag, TrainingOptions(**{name: value})
        assert by_command(*([f"{flag}={word}" for word in words] or [flag])) == expected
        if name != "settings":
            assert by_command(f"--set={name}={' '.join(words) or 'true'}") == expected
        config = tmp_path / "options.toml"
        config.write_text(f"[{name}]\n{toml(value)}" if isinstance(value, dict) else f"{name} = {json.dumps(value)}\n")
        assert by_command("--config", str(config)) == expected


def toml(values: dict[str, Any]) -> str:
    return "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())


def test_the_command_line_reaches_every_setting_of_a_recipe() -> None:
    base = recipe("draft")
    for name, meaning in meanings_of(Recipe).items():
        chosen = given_texts([f"{name}={text(getattr(base, name))}"])
        assert (name in chosen) is (name in OPTIONS) and (name in OPTIONS or name in chosen["settings"])
        assert meaning.help
    chosen = by_command("--recipe=draft", "--set=hidden_width=32", "--set", "modulation=false", "--set=seed=4")
    assert chosen.chosen_recipe() == recipe("draft", capacity="auto", hidden_width=32, modulation=False)
    assert chosen.seed == 4


def text(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value).lower()


def test_what_is_said_last_counts(tmp_path: Path) -> None:
    """An option, before --set, before the file; settings of the recipe each by itself."""
    config = tmp_path / "options.toml"
    config.write_text('recipe = "draft"\nseed = 1\nsteps = 5\nhidden_width = 16\n[settings]\nhead_width = 8\n')
    chosen = by_command("--config", str(config), "--set", "seed=2", "--set", "head_width=9", "--seed", "3")
    assert (chosen.recipe, chosen.seed, chosen.steps) == ("draft", 3, 5)
    assert chosen.settings == {"hidden_width": 16, "head_width": 9}


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("stepz = 3", "no option or setting 'stepz'; the nearest is 'steps'."),
        ("[settings]\nhiden_width = 3", "no setting 'hiden_width'; the nearest is 'hidden_width'."),
        ('steps = "3"', "steps is '3', expected none, or a whole number from 1 to "),
        ("steps = ", "found text that is no TOML (Invalid value"),
        ("a" * 2**21, "of at most 1,048,576"),
    ],
)
def test_a_file_that_says_something_else_is_a_sentence(run: Run, content: str, sentence: str, tmp_path: Path) -> None:
    config = tmp_path / "options.toml"
    config.write_text(content)
    status, _, err = run("train", tmp_path, "--out", tmp_path / "x.frog", "--config", config)
    assert status == 2 and sentence in err and err.count("\n") == 1


@pytest.mark.parametrize("words", ["stepz=3", "steps", "hidden_width=-1", "sh_growth=1,x", "settings=a=1"])
def test_settings_that_are_none_are_a_sentence(run: Run, words: str, tmp_path: Path) -> None:
    status, _, err = run("train", tmp_path, "--out", tmp_path / "x.frog", "--set", words)
    assert status == 2 and err.count("\n") == 1


def test_python_has_every_option() -> None:
    shown = inspect.signature(frog.train).parameters
    assert {name: shown[name].default for name in OPTIONS} == {name: option.default for name, option in OPTIONS.items()}
    assert all(f"    {name}: " in (frog.train.__doc__ or "") for name in OPTIONS)


@pytest.mark.parametrize("name", OPTIONS)
def test_python_checks_every_option_before_anything_is_opened(name: str, tmp_path: Path) -> None:
    for value in wrong(name):
        sentence = refused(".", frog.train, tmp_path / "no capture", tmp_path / "x.frog", **{name: value})
        assert name in sentence or name == "settings"
        assert "no capture" not in sentence and len(sentence) < 500


def test_python_names_the_nearest_option(tmp_path: Path) -> None:
    with pytest.raises(FrogError, match="no option 'max_gausians'; the nearest is 'max_gaussians'"):
        frog.train(tmp_path, tmp_path / "x.frog", max_gausians=3)
    for capture, output, expected in ((5, "x.frog", "an open capture, or its path"), (tmp_path, None, "a path")):
        refused(f"expected {expected}", frog.train, capture, output)


def test_python_takes_a_recipe_as_it_is_and_numbers_of_numpy() -> None:
    numpy = pytest.importorskip("numpy")
    own = frog.recipe("draft", hidden_width=32)
    assert training_options({"recipe": own, "steps": numpy.int64(5)}).chosen_recipe() == own
    assert training_options({"recipe": own, "capacity": "auto"}).chosen_recipe().capacity == "auto"
    assert training_options({"recipe": "paper-exact"}).chosen_recipe().capacity == "fixed"
    assert training_options({"recipe": "paper-exact", "capacity": "auto"}).chosen_recipe().capacity == "auto"
    assert training_options({"steps": numpy.int64(5), "scale": numpy.float32(0.5)}) == TrainingOptions(
        steps=5, scale=0.5
    )


def test_a_job_has_every_option_and_a_checkpoint_those_that_are_kept(tmp_path: Path) -> None:
    given = {name: value for name, (value, _) in EXAMPLES.items() if name in JobOptions.__dataclass_fields__}
    job = TrainingJob.of_options(tmp_path, tmp_path / "x.frog", TrainingOptions(**given))
    assert all(getattr(job, name) == value for name, value in given.items())
    stored = json.loads(json.dumps(job.stored_settings()))
    assert stored.keys() - {"recipe", "capture"} == set(STORED)
    again = TrainingJob(tmp_path, tmp_path / "x.frog", **{name: stored[name] for name in STORED})
    free = {name for name in given if OPTIONS[name].resume is Resume.FREE}
    assert {name for name in given if getattr(again, name) != given[name]} == free
    anew = {name for name, option in OPTIONS.items() if option.resume is Resume.ANEW}
    assert anew == {"steps", "seconds", "max_bytes"}


def test_the_table_and_estimates_need_neither_torch_nor_blender(tmp_path: Path) -> None:
    code = """
import sys
sys.modules["torch"] = sys.modules["bpy"] = None
from frog_blender.engine.options import TrainingOptions
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.time_estimate import Workload, estimate, likely_device
job = TrainingJob.of_options("capture", "x.frog", TrainingOptions(steps=5))
print(job.steps, estimate(Workload(job.recipe, job.steps, 1e5, 9), likely_device("cpu")))
"""
    run = run_python(code, FROG_CACHE=str(tmp_path))
    assert run.stdout.startswith("5 Roughly"), run.stderr


def test_the_page_has_the_table() -> None:
    command = [sys.executable, str(REPOSITORY / "tools" / "option_table.py"), "--check"]
    printed(subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY))


def test_a_recipe_is_listed(run: Run) -> None:
    said = run("recipes", "paper-exact")[1]
    assert all(f"  {name} = " in said for name in meanings_of(Recipe))
    assert "  head_width = 128: " in said and "\nDeformation\n" in said and panel_options()
