"""Input of the commands: checks of options that depend on each other, and the tissue from files and sizes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxtissue.geometry.domain_files import load_domain, load_tube
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import domain_of
from jaxtissue.geometry.tube import TUBE_SIZES, Tube
from jaxtissue.runs.backbone_files import BackboneTable, find_tube, read_backbones
from jaxtissue.runs.distributed import Part, join, slurm_part
from jaxtissue.topology.statistics import Connectivity, find_connectivity


def need_relative(arguments: dict[str, Any], given: dict[str, Any]) -> None:
    """Raise `ValueError` for --relative with defaults that have units."""
    for name in ("tension", "temperature"):
        if arguments.get("relative") and name not in given:
            raise ValueError(f"--relative needs a dimensionless --{name}; see --help for the values of the paper")


def refuse_both(arguments: dict[str, Any], *names: str) -> None:
    """Raise `ValueError` for an option that asks for contacts beside --no-contacts."""
    for name in names:
        if arguments.get("no_contacts") and arguments.get(name):
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} needs contacts; remove either this option or --no-contacts")


def refuse_tolerance(domain: Tube | Domain, tolerance: float | None) -> None:
    """Raise `ValueError` for a tolerance on other domains than tubes."""
    if tolerance is not None and not isinstance(domain, Tube):
        raise ValueError("--tolerance is available for tubes only; use --resolution fine for other domains")


def found_contacts(positions: Any, domain: Tube | Domain, minimum: float) -> Connectivity:
    """The contacts of a tissue. Raises `ValueError` that names the way without them where they can't be found."""
    try:
        return find_connectivity(positions, domain, minimum)
    except ValueError as error:
        raise ValueError(f"{error}, or measure sizes only, with --no-contacts") from error


def read_tissue(arguments: dict[str, Any]) -> tuple[Tube | Domain, BackboneTable]:
    """The tube or other domain and the backbones that a command is given."""
    sized = any(name in arguments for name in TUBE_SIZES)
    domain = given_domain(arguments, load_domain) or (None if sized else find_tube(arguments["file"]))
    domain = domain or Tube(*_tube_sizes(arguments))
    backbones = read_backbones(arguments["file"], domain, arguments["degrees"], bent=True)
    return domain_of(domain, backbones.positions), backbones


def given_domain(
    arguments: dict[str, Any], load: Callable[[Path], Any] = load_tube, sizes: Sequence[str] = TUBE_SIZES
) -> Any:
    """The domain of --domain, which is taken out of the arguments. Raises `ValueError` for sizes beside it."""
    path = arguments.pop("domain", None)
    if path is None:
        return None
    for name in sizes:
        if name in arguments:
            option = "--" + name.replace("_", "-")
            raise ValueError(f"{option} conflicts with the domain in {path}; remove either this option or --domain")
    return load(path)


def _tube_sizes(arguments: dict[str, Any]) -> list[float]:
    """The sizes of the tube. Raises `ValueError` where one is not given."""
    missing = ["--" + name.replace("_", "-") for name in TUBE_SIZES if name not in arguments]
    if missing:
        raise ValueError(f"missing {', '.join(missing)}; give all sizes of the tube, or a file with --domain")
    return [arguments[name] for name in TUBE_SIZES]


def find_part(
    part: tuple[int, int] | None,
    slurm: bool,
    distributed: bool,
    coordinator: str | None,
    process: tuple[int, int] | None,
) -> Part:
    """The part of the work that this process does."""
    if not distributed and (coordinator or process):
        raise ValueError("--coordinator and --process require --distributed; add it")
    if (coordinator is None) != (process is None):
        raise ValueError(
            "--coordinator and --process require each other; give both, or none on a cluster that JAX detects"
        )
    if distributed:
        return join(coordinator, process)
    if slurm:
        return slurm_part()
    return Part(*part) if part else Part()
