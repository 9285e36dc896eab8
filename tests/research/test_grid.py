"""What a chart runs: names that stay, and everything that was asked for."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

from frog_blender.engine.recipes import recipe
from frog_blender.research.grid import ABLATIONS, Run, ablation_variants, chart_grid

CAPTURES = {"room": Path("/somewhere/room"), "dim": Path("/somewhere/dim")}
RUN = Run("room", "/somewhere/room", "frog", "FRoG", overrides=(("fusion", "add"),))


def test_a_key_stays_the_same() -> None:
    """Results are committed: a key of today must be found again tomorrow."""
    assert RUN.key == "ccfe9a7d9de7d4a1"
    assert replace(RUN, capture="/elsewhere/room", label="another name", group="fusion").key == RUN.key
    assert Run("room", "/x", "frog", "FRoG", steps=100).key == "55fc63145983a440"
    swapped = (("fusion", "add"), ("sampling", "off"))
    assert replace(RUN, overrides=swapped).key == replace(RUN, overrides=swapped[::-1]).key


def test_what_decides_the_result_decides_the_key() -> None:
    changes = {"scene": "dim", "method": "ed3dgs", "recipe": "standard", "overrides": (("fusion", "concat"),)}
    changes |= {"seed": 1, "steps": 100, "equal_time": True, "scale": 0.5, "holdout_frames": 8, "protocol": "n3dv"}
    changes |= {"condition": "clean"}
    keys = {replace(RUN, **{name: value}).key for name, value in changes.items()}
    assert len(keys | {RUN.key}) == len(changes) + 1


def test_a_grid_is_what_was_asked_for() -> None:
    runs = chart_grid(CAPTURES, seeds=(3, 2), rows=["frog", "frog-auto", "ed3dgs", "static"], equal_time=True)
    assert len({run.key for run in runs}) == len(runs)
    counts = Counter((run.method, run.equal_time) for run in runs)
    assert counts == {
        ("frog", False): 12,
        ("ed3dgs", False): 6,
        ("ed3dgs", True): 6,
        ("static", False): 4,
        ("static", True): 4,
    }
    assert [run.equal_time for run in runs] == sorted(run.equal_time for run in runs)
    equal_steps = [run.seed for run in runs if not run.equal_time]
    assert equal_steps == sorted(equal_steps), "a first seed of everything comes first"
    assert {run.label for run in runs} == {"FRoG", "FRoG auto", "E-D3DGS", "3DGS (static)"}
    assert [run.settings().capacity for run in runs if run.label == "FRoG auto"] == ["auto"] * 6
    assert all(run.capture == str(CAPTURES[run.scene]) for run in runs)


def test_an_ablation_changes_one_thing_at_a_time() -> None:
    base = recipe("draft")
    runs = chart_grid({"room": CAPTURES["room"]}, seeds=(2, 1), rows=["frog"], ablation=ABLATIONS)
    rows = {run.label: run for run in runs if run.group != "methods"}
    assert set(rows) >= {f"fusion: {name}" for name in ("add", "concat", "attention", "coarse", "fine", "dual")}
    assert {"sampling: off", "sampling: inverse", "sampling: mean depth", "opacity: off", "opacity: paper"} <= set(rows)
    assert {"k = 1", "k = 5", "k = 20", "modulation: off", "seeds: at one time", "loss: without squares"} <= set(rows)
    assert {"12,500 Gaussians", "5% move"} <= set(rows)
    for run in rows.values():
        settings = run.settings()
        changed = {name for name in vars(base) if getattr(settings, name) != getattr(base, name)}
        assert len(changed) == (2 if run.group == "capacity" else 1), (run.label, changed)
    assert Counter(run.label for run in runs)["sampling: off"] == 2
    assert len({run.key for run in runs}) == len(runs)


def test_an_ablation_leaves_out_what_the_recipe_does_itself() -> None:
    base = recipe("draft", opacity_reduction="off", sampling="off", fusion="dual", modulation=False)
    variants = ablation_variants(base, ABLATIONS)
    assert list(variants["modulation"]) == ["modulation: on"]
    plain = ablation_variants(recipe("paper"), ABLATIONS)
    assert not plain["seeds"] and not plain["loss"]
    assert list(ablation_variants(recipe("draft", moment_seeds=False), ["seeds"])["seeds"]) == ["seeds: at many times"]
    assert "fusion: dual" not in variants["fusion"] and "fusion: product" in variants["fusion"]
    assert "sampling: off" not in variants["sampling"] and "opacity: off" not in variants["opacity"]
    assert all(changes["opacity_reduction"] == "unit" for changes in variants["k"].values())


def test_more_rows() -> None:
    rows = [("E-D3DGS, own rates", "ed3dgs", {"network_rate": 1e-4})]
    common = Run(overrides=(("network_rate", 1e-2), ("sh_degree", 2)))
    runs = chart_grid(CAPTURES, common, seeds=(3, 2), rows=rows)
    assert len(runs) == 4 and {run.group for run in runs} == {"methods"}
    assert runs[0].plain_recipe().network_rate == 1e-4 and runs[0].plain_recipe().sh_degree == 2
    assert runs[0].settings().fusion == "dual"
