"""A grid of annealing runs: one row for every combination of the given values."""

import hashlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from jaxtissue.runs.settings import Settings

AXES = ("length", "basal_radius", "ratio", "apical_radius", "cells", "modulus", "tension", "temperature")
AXES += ("seed",)  # the later, the faster it runs
SIZES = ("length", "basal_radius", "ratio", "apical_radius")  # of tubes: what a domain of a file takes the place of
_SETTINGS = {setting.name for setting in fields(Settings)}


@dataclass(frozen=True)
class Grid:
    """Runs for all combinations of the values in `axes`; `shared` holds the settings that all have.

    An axis is one of `AXES`, `ratio` being R_b / R_a; what is on no axis and not shared has its default. Each
    row is the run that `jaxtissue anneal` makes with the same settings, to the bit. Raises `ValueError` for
    other names, an axis without values, a value given twice, both `ratio` and `apical_radius`, sizes beside a domain,
    and sizes that make no tube.

    >>> grid = Grid({"seed": [0, 1], "ratio": [2, 5]}, {"sweeps": 3})
    >>> [(row.apical_radius, row.seed) for row in grid.rows]
    [(5.0, 0), (5.0, 1), (2.0, 0), (2.0, 1)]
    """

    axes: Mapping[str, list]
    shared: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, values in self.axes.items():
            if name not in AXES:
                raise ValueError(f"{name!r} is not a grid parameter; use one of {', '.join(AXES)}")
            if not values:
                raise ValueError(f"{name} has no values; give at least one, or remove it")
            for value in values:
                if values.count(value) > 1:
                    raise ValueError(f"{name}={value} is given twice; remove one of them")
        for name in self.shared:
            if name not in _SETTINGS or name in self.axes:
                raise ValueError(f"{name!r} is not a setting that all rows share; remove it")
        if {"ratio", "apical_radius"} <= self.axes.keys():
            raise ValueError("ratio and apical_radius both set the radius of the lumen; remove one of them")
        for name in SIZES:
            if self.shared.get("domain") is not None and name in self.axes:
                raise ValueError(f"{name} is a size of a tube, but a domain is given; remove {name} or the domain")
        for row in self.rows:
            _ = row.place

    @property
    def rows(self) -> list[Settings]:
        """The settings of each run."""
        names = [name for name in AXES if name in self.axes]
        combinations = itertools.product(*(self.axes[name] for name in names))
        return [self._settings(dict(zip(names, values, strict=True))) for values in combinations]

    @property
    def identities(self) -> list[str]:
        """A name for each run, which its settings alone decide: it has the same in a larger grid.

        >>> small, large = Grid({"seed": [7]}), Grid({"seed": [1, 7]})
        >>> small.identities[0] == large.identities[1]
        True
        """
        settings = (json.dumps(asdict(row), sort_keys=True) for row in self.rows)
        return [hashlib.sha256(text.encode()).hexdigest()[:16] for text in settings]

    @property
    def arguments(self) -> dict[str, Any]:
        """All that the rows are made of, defaults included: lists for what an axis may be, else one value."""
        listed = {name: list(values) for name, values in self.axes.items()}
        for setting in fields(Settings):
            name, value = setting.name, self.shared.get(setting.name, setting.default)
            if name in ("backbones", "degrees") or (name == "apical_radius" and "ratio" in self.axes):
                continue
            if name in SIZES if self.shared.get("domain") is not None else name == "domain":
                continue
            listed.setdefault(name, [value] if name in AXES else value)
        return listed

    def growth(self, before: Mapping[str, Any]) -> list[str]:
        """The axes on which this grid has more values than one whose `arguments` were `before`.

        Raises `ValueError` where the other is no part of this one, naming what differs.
        """
        grown, given = [], self.arguments
        for name in dict(before) | given:
            then, here = before.get(name), given.get(name)
            if then == here:
                continue
            if not (isinstance(then, list) and isinstance(here, list) and set(then) <= set(here)):
                option, values = "--" + name.replace("_", "-"), (here, then)
                told = " differs from ".join(_told(value) for value in values)
                raise ValueError(f"{option} {told}")
            grown.append(name)
        return grown

    def _settings(self, values: dict[str, Any]) -> Settings:
        if "ratio" in values:
            outer = values.get("basal_radius", self.shared.get("basal_radius", Settings.basal_radius))
            values["apical_radius"] = outer / values.pop("ratio")
        return Settings(**self.shared, **values)


def _told(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(map(str, value))
    return "(not given)" if value is None else str(value)


def describe(row: Settings) -> dict[str, Any]:
    """The parameters of a run as columns of the table."""
    names = ("cells", "modulus", "tension", "temperature", "seed", "sweeps", "algorithm", "resolution")
    values = _sizes(row) | {name: getattr(row, name) for name in names}
    values |= {"relative": True} if row.relative else {}
    return values | ({} if row.final_temperature is None else {"final_temperature": row.final_temperature})


def _sizes(row: Settings) -> dict[str, Any]:
    """The sizes of a tube, or the shape and the sizes of another domain, one number each."""
    if row.domain is None:
        sizes = {name: getattr(row, name) for name in ("length", "apical_radius", "basal_radius")}
        return {"ratio": row.basal_radius / row.apical_radius} | sizes
    found = {}
    for name, value in row.domain.items():
        several = value if isinstance(value, list | tuple) else None
        found |= {f"{name}_{k + 1}": part for k, part in enumerate(several)} if several else {name: value}
    return found
