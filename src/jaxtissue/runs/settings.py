"""The arguments of an annealing run, stored in its folder and checked when it is resumed."""

import importlib.metadata
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtissue.compilation.fusion import options
from jaxtissue.dynamics.annealer import Annealer
from jaxtissue.dynamics.schedules import constant_schedule, geometric_schedule
from jaxtissue.energy import Model, tube_model
from jaxtissue.geometry.domain_files import read_domain
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.tube import Tube

FORMAT = 1  # of what a folder keeps; raised when other code would play other sweeps, or read it otherwise
DECISIVE = ("jaxtissue", "jax", "jaxlib", "numpy")  # packages whose versions may decide bits


@dataclass(frozen=True)
class Settings:
    """The arguments of a run; the paper's values (section 4.3) are the defaults.

    `backbones` is a CSV file to start from, its angles in `degrees` or radians; else `cells` random ones are
    made from `seed`. A `final_temperature` makes the cooling geometric. The run ends early when the energy
    has not fallen for `patience` sweeps (0: never). Walls below `minimum_contact`, a fraction of the mean
    wall, are no contacts. `relative` constants and temperatures are those of `tube_model`. A `domain` is that of a
    file, shape and sizes, in place of the sizes of the tube.
    """

    length: float = 100.0
    apical_radius: float = 1.0
    basal_radius: float = 10.0
    backbones: str | None = None
    degrees: bool = False
    cells: int = 500
    seed: int = 0
    sweeps: int = 100
    temperature: float = 2.0
    final_temperature: float | None = None
    modulus: float = 1.0
    tension: float = 0.4
    relative: bool = False
    algorithm: str = "is-mh"
    resolution: str = "draft"
    patience: int = 0
    minimum_contact: float = 0.0
    no_contacts: bool = False
    x64: bool = False
    domain: Mapping[str, Any] | None = None

    @property
    def place(self) -> Tube | Domain:
        """The tube or other domain of the tissue. Raises `ValueError` for sizes that make none."""
        if self.domain is not None:
            return read_domain(self.domain)
        return Tube(self.length, self.apical_radius, self.basal_radius)

    @property
    def tube(self) -> Tube:
        """The domain, for what takes only tubes. Raises `ValueError` for other domains."""
        place = self.place
        if not isinstance(place, Tube):
            raise ValueError(f"the domain of the tissue is a {type(place).__name__}, but only a tube is supported here")
        return place

    def temperatures(self, cooling_sweeps: int) -> Float[np.ndarray, "sweeps"]:
        """Temperature of each sweep: constant, or falling over the first `cooling_sweeps` and then held."""
        if self.final_temperature is None:
            return np.asarray(constant_schedule(self.temperature, self.sweeps))
        cooling = np.asarray(geometric_schedule(self.temperature, self.final_temperature, cooling_sweeps))
        held = np.asarray(constant_schedule(self.final_temperature, self.sweeps - cooling_sweeps))
        return np.concatenate([cooling, held])

    @property
    def model(self) -> Model:
        """The energy of the run. Raises `ValueError` for constants that make none."""
        return tube_model(self.place, self.cells, self.modulus, self.tension, relative=self.relative)

    def annealer(self, cooling_sweeps: int) -> Annealer:
        """The annealer of the run. Raises `ValueError` for settings that cannot be annealed."""
        temperatures = self.temperatures(cooling_sweeps)
        return Annealer(self.model, self.resolution, self.algorithm, self.seed, temperatures)


def saved_settings(manifest: Mapping[str, Any], given: Mapping[str, Any], place: str) -> Settings:
    """The settings in a run's manifest; of the `given` ones only `sweeps` may differ, and only grow.

    Raises `ValueError` for any other change, naming it, and for a run in `place` that other code began, whose
    sweeps this code would not continue.
    """
    if manifest.get("format") != FORMAT:
        formats = f"format {manifest.get('format')}, this is {FORMAT}"
        told = f"the run in {place} was started by another version of jaxtissue ({formats})"
        raise ValueError(f"{told}; add --force to start again from the beginning")
    try:
        saved = Settings(**manifest["arguments"])
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"the manifest in {place} is damaged ({error}); add --force to start again from the beginning"
        ) from error
    if given.get("backbones") and not saved.backbones:
        raise ValueError("the run to resume started from random cells; remove --backbones")
    for name, value in given.items():
        before = getattr(saved, name)
        if name == "sweeps" and value < before:
            raise ValueError(f"--sweeps {value} is less than the {before} of the run to resume; give at least {before}")
        if name not in ("sweeps", "backbones") and value != before:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} {value} differs from {before}, the value of the run to resume; remove {option}")
    return replace(saved, sweeps=given.get("sweeps", saved.sweeps))


def versions() -> dict[str, str]:
    """The versions of Python and of the packages that results depend on."""
    packages = (*DECISIVE, "scipy")
    return {"python": platform.python_version()} | {name: version_of(name) or "unknown" for name in packages}


def version_of(package: str) -> str | None:
    """The version of an installed package, None where it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def provenance() -> dict[str, Any]:
    """The time and the software and hardware of a computation."""
    device = jax.devices()[0]
    return {
        "started": now(),
        "versions": versions(),
        "platform": platform.platform(),
        "device": str(device),
        "dtype": str(jnp.result_type(float)),
        "device_kind": device.device_kind,
        "processor": processor(),
        "compiler": options() | {"XLA_FLAGS": os.environ.get("XLA_FLAGS", "")},
    }


def processor() -> str:
    """Name and widest vectors of the processor, as far as the system tells: bits depend on these."""
    info = Path("/proc/cpuinfo")
    told = info.read_text(errors="replace") if info.is_file() else ""
    name = re.search(r"^model name\s*: (.*)", told, re.MULTILINE)
    vectors = next((kind for kind in ("avx512f", "avx2", "avx") if re.search(rf"\b{kind}\b", told)), "")
    return ", ".join(filter(None, (name[1] if name else platform.processor(), vectors)))


def other_bits(before: Mapping[str, Any]) -> str:
    """The conditions that decide the bits of a result and differ from `before`, in words; empty if none does."""
    present = provenance()
    kinds = {"device_kind": "device", "processor": "processor", "compiler": "compiler"}
    pairs = [(told, before.get(name), present[name]) for name, told in kinds.items()]
    pairs += [(name, before.get("versions", {}).get(name), present["versions"][name]) for name in DECISIVE]
    changes = [f"{name} was {then}, now {here}" for name, then, here in pairs if then != here]
    return "; ".join(changes)


def now() -> str:
    """The time, in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
