"""What a training says of its capacity: in words, and in an image."""

from typing import Any

from frog_blender.engine.scene.compression_report import lines, reduction_line, summary


def reduced(*values: object) -> dict[str, Any]:
    names = ("what", "progress", "before", "after", "loss", "bytes")
    return dict(zip(names, values, strict=True))


CAPACITY: dict[str, Any] = {
    "gaussians": 20_704,
    "dynamic": 5_927,
    "sh_degree": 1,
    "reductions": [
        reduced("put to rest", 0.85, 20_704, 5_927, 0.0213, 1_890_000),
        reduced("pruned", 0.93, 6_000, 5_927, None, -9),
    ],
}


def test_the_report_in_words() -> None:
    assert summary(CAPACITY) == "20,704 Gaussians, 5,927 of them dynamic; SH degree 1"
    freeze, prune = lines(CAPACITY)
    expected = "at 85 %, freeze: 20,704 -> 5,927 dynamic Gaussians; saves 1.89 MB; costs 0.021 dB"
    assert freeze == expected
    assert prune == "at 93 %, prune: 6,000 -> 5,927 Gaussians"
    assert lines({}) == []
    assert reduction_line(CAPACITY["reductions"][0] | {"is_forced": True}) == f"{freeze}, which a limit forces"
