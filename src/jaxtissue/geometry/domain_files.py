"""Domains as files: a JSON object with the name of a shape and its sizes, read whole or refused.

To add a shape is to add its row to `SHAPES`.
"""

import functools
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxtissue.geometry.shapes import BentTube, Ellipsoid, EllipticTube, Fold, RoundTube, Slab, Sphere
from jaxtissue.geometry.tube import Tube
from jaxtissue.system.files import write_json

LARGEST = sys.float_info.max
Reader = Callable[[Any], Any]  # of one size: it raises `ValueError` that says what to give


def number(value: Any) -> float:
    """A finite number; `Tube` and other domains say themselves which numbers they take."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise ValueError("it must be a finite number")
    return float(value)


def flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError("it must be true or false")
    return value


def several(count: int, reader: Reader) -> Reader:
    """A reader of a list of `count` values, each read by `reader`."""

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"it must be a list of {count} values")
        return tuple(map(reader, value))

    return read


class Shape(NamedTuple):
    """How the domains of one shape stand in a file.

    Attributes:
        kind: The class of its domains.
        sizes: A reader for each size, by its name in the file, which is also that of the attribute.
        make: Makes a domain from the sizes, given by name.
        defaults: Sizes that may be left out; attributes that a domain need not have.
    """

    kind: type
    sizes: Mapping[str, Reader]
    make: Callable[..., Any]
    defaults: Mapping[str, Any] = {}


def _tube(length: float, apical_radius: float, basal_radius: float, periodic: bool) -> Tube | RoundTube:
    """A tube with ends has its own way of being measured, at any ratio of radii."""
    make = functools.partial(RoundTube, periodic=True) if periodic else Tube
    return make(length, apical_radius, basal_radius)


SHAPES: dict[str, Shape] = {
    "tube": Shape(
        Tube,
        {"length": number, "apical_radius": number, "basal_radius": number, "periodic": flag},
        _tube,
        {"periodic": False},
    ),
    # the same tube as any other domain is, for tilted and bent backbones
    "round_tube": Shape(RoundTube, {"length": number, "apical_radius": number, "basal_radius": number}, RoundTube),
    "slab": Shape(
        Slab,
        {"width": number, "depth": number, "thickness": number, "periodic": several(2, flag)},
        Slab,
        {"periodic": (False, False)},
    ),
    "elliptic_tube": Shape(
        EllipticTube,
        {"length": number, "apical_axes": several(2, number), "basal_axes": several(2, number)},
        EllipticTube,
    ),
    "bent_tube": Shape(
        BentTube, {"bend_radius": number, "arc": number, "apical_radius": number, "basal_radius": number}, BentTube
    ),
    "sphere": Shape(Sphere, {"apical_radius": number, "basal_radius": number}, Sphere),
    "ellipsoid": Shape(Ellipsoid, {"apical_axes": several(3, number), "basal_axes": several(3, number)}, Ellipsoid),
    "fold": Shape(
        Fold, {"width": number, "depth": number, "amplitude": number, "wavelength": number, "thickness": number}, Fold
    ),
}


def load_domain(path: str | Path) -> Any:
    """Read a domain from a JSON file.

    The file holds one object with the key "shape" and the dimensions of that shape, for example `{"shape": "tube",
    "length": 40, "apical_radius": 2, "basal_radius": 8}`; `jaxtissue fit` writes such files. Shapes are "tube",
    "round_tube" (a tube whose backbones may be tilted or bent), "slab", "elliptic_tube", "bent_tube", "sphere",
    "ellipsoid" and "fold". The keys are the attribute names of the classes; the key "periodic" of "tube" (true or
    false) and of "slab" (a list of two) is optional and defaults to false.

    Args:
        path: Path of the file.

    Returns:
        The domain, in the length unit of the file: a `Tube`, a `RoundTube` for "round_tube" or a periodic "tube", or an
        instance of `Slab`, `EllipticTube`, `BentTube`, `Sphere`, `Ellipsoid` or `Fold`.

    Raises:
        ValueError: If the file cannot be read or is not a JSON object, if the shape is unknown, or if a dimension is
            missing, unknown, given twice, not finite, or invalid for the shape.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "domain.json"
    ...     _ = path.write_text('{"shape": "tube", "length": 40, "apical_radius": 2, "basal_radius": 8}')
    ...     load_domain(path)
    Tube(length=40.0, apical_radius=2.0, basal_radius=8.0)
    """
    path = Path(path)
    try:
        return read_domain(_read_object(path))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_domain(values: Mapping[str, Any]) -> Any:
    """The domain with a shape and sizes, as they stand in a file. Raises `ValueError` as `load_domain` does.

    >>> read_domain({"shape": "tube", "length": 40, "apical_radius": 2})
    Traceback (most recent call last):
    ValueError: the size 'basal_radius' of the shape 'tube' is missing; add it
    """
    sizes = dict(values)
    if "shape" not in sizes:
        raise ValueError(f'"shape" is missing; add it, with one of the values {", ".join(SHAPES)}')
    name = sizes.pop("shape")
    if not isinstance(name, str) or name not in SHAPES:
        raise ValueError(f"shape={name!r} is unknown; give one of {', '.join(SHAPES)}")
    shape = SHAPES[name]
    for size in sizes:
        if size not in shape.sizes:
            raise ValueError(f"{size!r} is not a size of the shape {name!r}; its sizes are {', '.join(shape.sizes)}")
    found = dict(shape.defaults)
    for size, read in shape.sizes.items():
        if size in sizes:
            try:
                found[size] = read(sizes[size])
            except ValueError as error:
                raise ValueError(
                    f"{size}={json.dumps(sizes[size])} of the shape {name!r} is invalid; {error}"
                ) from None
        elif size not in found:
            raise ValueError(f"the size {size!r} of the shape {name!r} is missing; add it")
    return shape.make(**found)


def domain_values(domain: Any) -> dict[str, Any]:
    """The shape and the sizes of a domain, as `read_domain` takes them.

    >>> domain_values(Tube(40, 2, 8))
    {'shape': 'tube', 'length': 40.0, 'apical_radius': 2.0, 'basal_radius': 8.0, 'periodic': False}
    """
    for name, shape in SHAPES.items():
        if type(domain) is shape.kind or (name == "tube" and isinstance(domain, RoundTube) and domain.periodic):
            sizes = {size: getattr(domain, size, shape.defaults.get(size)) for size in shape.sizes}
            return {"shape": name} | {size: np.asarray(value).tolist() for size, value in sizes.items()}
    raise ValueError(
        f"a {type(domain).__name__} cannot be written to a file; give one of the shapes {', '.join(SHAPES)}"
    )


def load_tube(path: str | Path) -> Tube:
    """The tube of a file, for what only tubes have yet. Raises `ValueError` for other domains, as for bad files."""
    domain = load_domain(path)
    if not isinstance(domain, Tube):
        told = f"the domain in {path} is not a tube with ends"
        raise ValueError(f"{told}; meshes, 3D pictures and exports support no other domain")
    return domain


def save_domain(domain: Any, path: str | Path) -> None:
    """Write a domain as `load_domain` reads it: whole, or not at all. Its sizes must not be traced."""
    write_json(Path(path), domain_values(domain))


def _read_object(path: Path) -> dict[str, Any]:
    """The one JSON object of a file."""
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_once)
    except OSError as error:
        raise ValueError(
            f"the file can't be read ({error.strerror}); give a JSON file that describes a domain"
        ) from error
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"the file is not valid JSON ({error}); give a JSON file that describes a domain") from error
    if not isinstance(values, dict):
        raise ValueError('the file contains no JSON object; write {"shape": ..., followed by its sizes}')
    return values


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The pairs of an object, none of them twice."""
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name!r} is given twice; remove one of them")
    return dict(pairs)
