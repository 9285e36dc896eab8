"""``frog eval``: the quality of a scene on its capture's images."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from .printing import say


def add_eval_parser(commands: Any) -> None:
    """Adds the command."""
    evaluate = commands.add_parser("eval", help="compare a scene with the capture's images")
    evaluate.add_argument("scene", type=Path)
    evaluate.add_argument("capture", type=Path)
    evaluate.add_argument("--mask", type=Path, help="an image, or an .npz with a mask for each camera")
    evaluate.add_argument("--split", choices=["auto", "held-out", "training"], default="auto")
    evaluate.add_argument("--perceptual", action="store_true", help="also FLIP and LPIPS, where they are installed")
    evaluate.add_argument("--metric", action="append", default=[], metavar="NAME", help="also this one, of a package")
    evaluate.add_argument("--json", action="store_true")
    evaluate.set_defaults(run=_eval)


def _eval(options: argparse.Namespace) -> int:
    from ..engine.evaluation.evaluate import evaluate_file
    from .progress import bar

    with bar("Evaluating") as report:
        figures = evaluate_file(
            options.scene,
            options.capture,
            split=options.split,
            mask_file=options.mask,
            perceptual=options.perceptual,
            metrics=options.metric,
            progress=report,
        )
    if options.json:
        print(json.dumps(figures, indent=1))
        return 0
    for key, reason in figures.pop("missing", {}).items():
        figures[key] = f"- ({reason})"
    for key, value in figures.items():
        if key != "cameras":
            say(f"{key:>18}  {value:.4f}" if isinstance(value, float) else f"{key:>18}  {value}")
    return 0
