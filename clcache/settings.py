"""Every setting, declared once: `clcache settings`, --set, the scene file's [render.settings] and the Python API all read this table."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from .errors import SettingError


@dataclass(frozen=True)
class Setting:
    """One setting: dotted name, default (whose type is the setting's type), inclusive range or choices, and meaning."""

    name: str
    default: bool | int | float | str
    meaning: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()

    @property
    def type(self) -> str:
        """The type's name as users know it: bool, int, float or str."""
        return type(self.default).__name__

    @property
    def range(self) -> str:
        """The values that are allowed, in words."""
        if self.choices:
            return ", ".join(self.choices)
        if isinstance(self.default, bool):
            return "true, false"
        if self.low is None and self.high is None:
            return "any"
        return f"{'' if self.low is None else f'{self.low:g}'} .. {'' if self.high is None else f'{self.high:g}'}"

    def parse(self, value: object) -> bool | int | float | str:
        """The value, from text or from a typed value, as the setting's type. Raises SettingError."""
        if isinstance(self.default, bool):
            parsed = _parse_bool(value)
        elif isinstance(self.default, str):
            parsed = value if isinstance(value, str) else None
        else:
            parsed = _parse_number(value, type(self.default))
        in_range = (
            parsed is not None
            and (not self.choices or parsed in self.choices)
            and (self.low is None or parsed >= self.low)
            and (self.high is None or parsed <= self.high)
        )
        if not in_range:
            raise SettingError(
                f"setting {self.name}: {value!r} is not {_article(self.type)} in range; expected {self.range}"
            )
        return parsed


def _article(type_name: str) -> str:
    return f"an {type_name}" if type_name[0] in "aeiou" else f"a {type_name}"


def _parse_bool(value: object) -> bool | None:
    if isinstance(value, bool):
        return value
    return {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}.get(str(value).lower())


def _parse_number(value: object, kind: type) -> int | float | None:
    if isinstance(value, bool) or (kind is int and isinstance(value, float)):
        return None
    try:
        number = kind(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if number == number else None  # NaN is no value of any setting


SETTINGS: dict[str, Setting] = {
    s.name: s
    for s in (
        Setting("pathtrace.bounces", 3, "indirect bounces after the first hit; 0 is direct light only", 0, 64),
        Setting("pathtrace.roulette", 2, "first bounce at which Russian roulette may end a path", 1, 64),
        Setting(
            "pathtrace.sampler",
            "sobol",
            "where sample points come from: an Owen-scrambled Sobol sequence, or independent random numbers",
            choices=("sobol", "independent"),
        ),
        Setting(
            "device.local_size",
            64,
            "work-items in a work-group of kernels that do not prescribe it; no effect on the image",
            1,
            1024,
        ),
    )
}


def find(name: str) -> Setting:
    """The setting of this dotted name. Raises SettingError, with the nearest known name."""
    if name in SETTINGS:
        return SETTINGS[name]
    near = difflib.get_close_matches(name, SETTINGS, 1)
    raise SettingError(
        f"setting {name}: unknown" + (f"; did you mean {near[0]}?" if near else "; 'clcache settings' lists all")
    )


def resolve(*layers: Mapping[str, object]) -> dict[str, bool | int | float | str]:
    """All settings by name: defaults, overridden by each layer in turn (values as text or typed). Raises SettingError."""
    values: dict[str, bool | int | float | str] = {name: s.default for name, s in SETTINGS.items()}
    for layer in layers:
        for name, value in layer.items():
            values[name] = find(name).parse(value)
    return values
