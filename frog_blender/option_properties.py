"""The table of options as Blender's properties, and what was chosen by them."""

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .engine.given_options import given_texts, joined, training_options
from .engine.options import OPTIONS, Option, RecipeSettings, TrainingOptions, panel_options
from .engine.setting import Choice, Number, OrNone, parsed

_LARGEST = 2**31 - 1  # of Blender's whole numbers


def property_name(option: Option) -> str:
    """What a property of ``Scene.frog`` is called that stands for an option."""
    return option.panel_name or option.name


def items_of(option: Option) -> list[tuple[str, str, str]]:
    """The items of a choice: name, label and description."""
    assert isinstance(option.plain_kind, Choice)
    shown = {str(value): option.items.get(str(value), (str(value), "")) for value in option.plain_kind.values}
    return [(value, label, _sentence(meaning)) for value, (label, meaning) in shown.items()]


def property_of(option: Option, **more: Any) -> Any:
    """A property that stands for an option, to be an annotation.

    Args:
        more: what Blender is told of it besides, or otherwise.
    """
    told: dict[str, Any] = {"name": option.label, "description": _sentence(option.help)}
    kind = option.plain_kind
    if option.unset and not isinstance(kind, Choice):
        nothing = {-1: "-1", 0: "Zero"}[_nothing(kind)] if isinstance(kind, Number) else "Empty"
        told["description"] += f". {nothing} for {option.unset}"
    if option.is_switch:
        return BoolProperty(**{**told, "default": option.default, **more})
    if isinstance(kind, Choice):
        return EnumProperty(**{**told, "items": items_of(option), "default": option.default, **more})
    if not isinstance(kind, Number):
        return StringProperty(**{**told, **more})
    is_whole = kind.whole and option.panel_unit == 1
    told["min"] = _nothing(kind) if isinstance(option.kind, OrNone) else kind.least
    told["default"] = told["min"] if option.default is None else option.default / option.panel_unit
    told["max"] = kind.most / option.panel_unit
    if not is_whole:
        return FloatProperty(**{**told, "min": float(told["min"]), **more})
    return IntProperty(**{**told, "default": int(told["default"]), "max": min(int(told["max"]), _LARGEST), **more})


def value_of(settings: Any, option: Option) -> Any:
    """What a property says of an option, None where it leaves that open.

    Raises:
        FrogError: for a text that the option does not take.
    """
    value, kind = getattr(settings, property_name(option)), option.plain_kind
    if isinstance(kind, Number):
        if isinstance(option.kind, OrNone) and value <= _nothing(kind):
            return None
        return round(value * option.panel_unit) if kind.whole else value * option.panel_unit
    if isinstance(option.kind, OrNone):
        return parsed(option.label, value, kind) if value else None
    return value


def chosen_options(settings: Any, **others: Any) -> TrainingOptions:
    """The options that the properties of ``Scene.frog`` stand for.

    Args:
        others: options that are chosen in another way.

    Raises:
        FrogError: for what cannot be.
    """
    read = [option for option in panel_options() if option.name not in others]
    values = {option.name: value_of(settings, option) for option in read if option.kind != OrNone(RecipeSettings())}
    texts = given_texts(getattr(settings, property_name(OPTIONS["settings"])).split())
    return training_options(joined(values, others, texts))


def _nothing(kind: Number) -> int:
    """The number that stands for none."""
    return 0 if kind.least > 0 and not kind.or_zero else -1


def _sentence(text: str) -> str:
    """As Blender writes descriptions: it adds the full stop itself."""
    return text[:1].upper() + text[1:]
