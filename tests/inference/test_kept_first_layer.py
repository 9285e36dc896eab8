"""What playback asks of the native deformation: the kept first layer, unit quaternions, constant colours."""

from __future__ import annotations

import numpy as np
import pytest
from fields import field_arrays, output_arrays

from frog_blender.engine.inference import kept_layer
from frog_blender.engine.inference.kept_layer import GROUP, kept_first_layer
from frog_blender.engine.rasterizer import native
from frog_blender.engine.rasterizer.native_deformation import FieldShape, PlayedField, deform


def kept(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same field without embeddings, their product with the first layer's weights in their place."""
    product = kept_first_layer(arrays["embeddings"], arrays["embedding_weight"])
    return {name: array for name, array in arrays.items() if name != "embeddings"} | {"first_layer": product}


def play(shape: FieldShape, arrays: dict[str, np.ndarray], result: dict[str, np.ndarray]) -> None:
    PlayedField(shape, arrays).deform(arrays["shared"], arrays["embedding_weight"], result)


@pytest.mark.parametrize("count", [1, GROUP, 3 * GROUP + 5, 200])
def test_the_product_lies_in_groups(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_layer, "_TOGETHER", 4 * GROUP)
    random = np.random.default_rng(0)
    embeddings, weight = random.normal(size=(count, 3)).astype("f"), random.normal(size=(5, 3)).astype("f")
    product, expected = kept_first_layer(embeddings, weight), embeddings @ weight.T
    assert product.dtype == np.float32 and product.shape == (-(-count // GROUP), 5, GROUP)
    for i, values in enumerate(expected):
        np.testing.assert_allclose(product[i // GROUP, :, i % GROUP], values, atol=1e-6)
    assert not product.transpose(0, 2, 1).reshape(-1, 5)[count:].any()


def test_heads_take_no_kept_product() -> None:
    shape = FieldShape(8, 4, 1, "off", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 20, 5, 30, sh_count=4)
    with pytest.raises(ValueError, match="heads"):
        deform(shape, kept(arrays), output_arrays(shape, 30))


@pytest.mark.parametrize("networks", [1, 2])
@pytest.mark.parametrize("hidden", [1, 33, 64])
@pytest.mark.parametrize("deformed", [0, 1, 4, 16])
@pytest.mark.parametrize("count", [1, 5, 16, 97, 1000])
def test_the_kept_product_gives_the_same(networks: int, hidden: int, deformed: int, count: int) -> None:
    # A sharpness of 10 would make the rounding of the opacity's change ten times larger.
    shape = FieldShape(0, 16, deformed, "unit", 1.0, 1.0, 0.5, networks)
    arrays = field_arrays(shape, hidden, 7, count)
    expected, found = output_arrays(shape, count, changes=True), output_arrays(shape, count, changes=True)
    deform(shape, arrays, expected)
    deform(shape, kept(arrays), found)
    for name, values in expected.items():
        assert np.isfinite(values).all()
        # The exponential makes an absolute error of the logarithm, which may be 4, a relative one.
        rtol = 3e-6 if name == "scales" else 1e-6
        np.testing.assert_allclose(found[name], values, rtol=rtol, atol=1e-6, err_msg=name)


def test_the_same_bits_on_any_number_of_threads() -> None:
    try:
        shape, results = FieldShape(0, 9, 4, "unit", 10.0, 1.0, 0.5, 2), []
        arrays = kept(field_arrays(shape, 33, 7, 5000))
        for threads in (1, 2, 7):
            native.set_thread_count(threads)
            results.append(output_arrays(shape, 5000))
            play(shape, arrays, results[-1])
        for name, values in results[0].items():
            assert all(result[name].tobytes() == values.tobytes() for result in results)
    finally:
        native.set_thread_count(0)


@pytest.mark.parametrize("count", [1, 97, 500])
def test_unit_quaternions(count: int) -> None:
    shape = FieldShape(0, 4, 1, "off", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 20, 5, count, sh_count=4)
    arrays["output_weight"][6:10], arrays["output_bias"][6:10] = 0, 0
    arrays["quaternions"][0] = 0  # has no direction, and gets none
    plain, unit = output_arrays(shape, count), output_arrays(shape, count)
    deform(shape, arrays, plain)
    play(shape, arrays, unit)
    lengths = np.linalg.norm(plain["quaternions"].astype(np.float64), axis=1, keepdims=True)
    np.testing.assert_allclose(unit["quaternions"], plain["quaternions"] / np.maximum(lengths, 1e-12), atol=3e-7)
    assert not unit["quaternions"][0].any()
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(unit[name], plain[name])


@pytest.mark.parametrize("deformed", [0, 1, 4, 16])
def test_colours_that_are_not_given_stay_in_the_output(deformed: int) -> None:
    shape = FieldShape(0, 16, deformed, "unit", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 20, 5, 300)
    expected, found = output_arrays(shape, 300), output_arrays(shape, 300)
    deform(shape, arrays, expected)
    found["sh"][:] = arrays["sh"]
    deform(shape, arrays | {"sh": np.ascontiguousarray(arrays["sh"][:, :deformed])}, found)
    np.testing.assert_array_equal(found["sh"], expected["sh"])
    np.testing.assert_array_equal(found["means"], expected["means"])
