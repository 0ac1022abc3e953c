"""One diagram and one sweep side by side with the C++ peer, on the paper's Table 1 (L = 100, R_b = 10).

Every contender has one thread. Ours counts lists and coloring in. The peer's IS-MH makes whole diagrams, as the
paper does, by the rule of two hops; its incremental MH changes one live triangulation. All start from the
same random tissue and play as many sweeps as fit the budget. Energies are compared after equal sweeps: by
`fine` on the backbones where a program tells them, else by its own measure.
"""

import time
from itertools import product
from typing import Any

import common
import jax
import jax.numpy as jnp
import numpy as np
from peer import Peer, find_peer

import jaxtissue as jt
from jaxtissue.dynamics.replays import SPAN
from jaxtissue.measurement.quadrature import as_resolution

RESOLUTIONS = ("draft", "standard", "fine", "3x4", "4x3.3", "7x7")
ALGORITHMS, SAMPLES = ("incremental MH", "IS-MH"), (4, 10, 50)
WARM_UP = 2 * SPAN  # sweeps before those timed as typical: in the first, lists are renewed more often
SWEEPS = WARM_UP + 4 * SPAN


def our_diagram(place: np.ndarray, tube: jt.Tube, size: jt.Resolution) -> dict[str, Any]:
    """Seconds and sizes of a diagram on the list a `CellMeasurer` keeps, and of one on complete lists found anew."""
    seconds, sizes = [], None
    begin = time.perf_counter()
    jax.block_until_ready(jt.measure_tissue(place, tube, size, surfaces=False, refine=False))
    scratch = time.perf_counter() - begin
    measurer = jt.CellMeasurer(tube, size)
    measurer.measure(place)
    for _ in range(5):
        begin = time.perf_counter()
        sizes = jax.block_until_ready(measurer.measure(place, check=False))
        seconds.append(time.perf_counter() - begin)
    assert sizes
    row = {"sizes": (sizes.volume, sizes.lateral_area)}
    return row | {"scratch": scratch, "diagram": float(np.median(seconds))}


def our_sweeps(place: np.ndarray, tube: jt.Tube, size: jt.Resolution) -> dict[str, Any]:
    """Warm seconds of the first sweep and of a typical one, and the backbones after every sweep.

    Sweeps that were played twice are counted in.
    """
    model = jt.tube_model(tube, len(place))
    annealer = jt.Annealer(model, size, "is-mh", 0, jt.constant_schedule(2.0, SWEEPS))
    state, records, trail = annealer.start(place), [], [place]
    annealer.record(state)
    while state.sweep < SWEEPS:
        state, rows, places = annealer.advance(state)
        records += rows
        trail += list(places)
    seconds = [record.seconds for record in records]
    energies = [record.energy for record in records]
    typical = float(np.mean(seconds[WARM_UP:]))
    row = {"sweep": typical, "first_sweep": seconds[0], "energies": energies, "trail": trail}
    return row | {"largest_drift": max(record.drift for record in records)}


def fine_energy(place: Any, tube: jt.Tube) -> float:
    """The tissue's energy by `fine`."""
    cells = jt.measure_tissue(jnp.asarray(place, jnp.result_type(float)), tube, jt.PRESETS["fine"], refine=False)
    return float(np.sum(jt.epithelial_energy(cells, jt.tube_model(tube, len(place))), dtype=float))


def peer_row(peer: Peer, place: np.ndarray, tube: jt.Tube, rival: tuple[str, int], budget: float) -> dict[str, Any]:
    """One diagram and several sweeps of the peer."""
    name, samples = rival
    found = peer.diagram(place, tube, samples)
    run = (peer.is_mh if name == "IS-MH" else peer.mh)(place, tube, samples, SWEEPS, budget)
    row = {"diagram": found.seconds, "sweep": run.seconds, "played": run.played, "own_energy": run.energy}
    if run.positions is not None:
        row["fine_energy"] = fine_energy(run.positions, tube)
    return row | {"sizes": (found.volume, found.lateral_area)}


def race(radius: float, n: int, peer: Peer | None, arguments: Any) -> dict[str, Any]:
    """One configuration: a turn of each contender, several times over; medians of the seconds."""
    tube = jt.Tube(100.0, radius, 10.0)
    place = np.asarray(tube.random_positions(jax.random.key(0), n))
    sizes = {name: as_resolution(name) for name in arguments.resolutions}
    ours: dict[str, list] = {name: [] for name in arguments.resolutions}
    theirs: dict[tuple[str, int], list] = {rival: [] for rival in product(ALGORITHMS, SAMPLES)}
    for size in sizes.values():  # compiled before the race
        our_diagram(place, tube, size)
        our_sweeps(place, tube, size)
    for _ in range(arguments.repeats):
        for name, size in sizes.items():
            ours[name].append(our_diagram(place, tube, size) | our_sweeps(place, tube, size))
        for rival, turns in theirs.items():
            if peer and not (turns and turns[0]["sweep"] > arguments.budget / 4):  # a long one once
                turns.append(peer_row(peer, place, tube, rival, arguments.budget))
    rows = {name: merged(turns) for name, turns in ours.items()}
    rows |= {f"{name} s={samples}": merged(turns) for (name, samples), turns in theirs.items() if turns}
    truth, trail = common.true_sizes(place, tube), rows[arguments.resolutions[0]]["trail"]
    for row in rows.values():
        row["volume"], row["lateral_area"] = truth.errors(*row.pop("sizes"))
        row.pop("trail", None)
        if row.get("played"):
            row["ours_fine_energy"] = fine_energy(trail[row["played"]], tube)
    start = fine_energy(place, tube)
    return {"apical_radius": radius, "cells": n, "start_energy": start, "rows": rows, "ratios": ratios(rows)}


def merged(turns: list[dict[str, Any]]) -> dict[str, Any]:
    """The last turn with the medians of all turns' seconds."""
    timed = ("diagram", "scratch", "sweep", "first_sweep")
    return turns[-1] | {key: float(np.median([turn[key] for turn in turns])) for key in timed if key in turns[0]}


def ratios(rows: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """How many times longer each of the peer takes than our fastest that is as true.

    As true: V and A at most the peer's own errors, or both within a bar (the peer may miss it by a fifth).
    """
    pairs = (("sweep", "sweep"), ("first_sweep", "sweep"), ("diagram", "diagram"), ("scratch", "diagram"))
    found = []
    for name, row in rows.items():
        if "scratch" in row:
            continue
        limits = {"its own errors": (row["volume"], row["lateral_area"])}
        limits |= {bar: most for bar, most in common.BARS.items() if meets(row, 1.2 * most[0], 1.2 * most[1])}
        for bar, most in limits.items():
            good = [key for key, other in rows.items() if "scratch" in other and meets(other, *most)]
            for what, theirs in pairs if good else ():
                best = min(good, key=lambda key, what=what: rows[key][what])
                line = {"peer": name, "bar": bar, "what": what, "ours": best}
                found.append(line | {"ratio": row[theirs] / rows[best][what]})
    return found


def meets(row: dict[str, Any], volume: float, area: float) -> bool:
    """Whether both errors are at most these."""
    return row["volume"] <= volume and row["lateral_area"] <= area


def report(result: dict[str, Any]) -> None:
    """The table of one configuration."""
    print(f"\nR_a = {result['apical_radius']:g}, n = {result['cells']}, energy {result['start_energy']:.0f}")
    heads = ("V %", "A %", "diagram ms", "scratch ms", "sweep ms", "first ms")
    print(f"{'':22}", *(f"{head:>10}" for head in heads))
    for name, row in result["rows"].items():
        numbers = [f"{100 * row[key]:10.4f}" for key in ("volume", "lateral_area")]
        for key in ("diagram", "scratch", "sweep", "first_sweep"):
            numbers.append(f"{1e3 * row[key]:10.1f}" if key in row else 10 * " ")
        print(f"{name:22}", *numbers, energies_told(row))
    for line in result["ratios"]:
        print(f"{line['peer']:20} / {line['ours']:9} {line['what']:12} {line['ratio']:8.1f} at {line['bar']}")


def energies_told(row: dict[str, Any]) -> str:
    """What a row of the peer tells beside its numbers."""
    if not row.get("played"):
        return "sweep extrapolated" if "played" in row else ""
    told = f"{row['own_energy']:.0f} by its own measure"
    if "fine_energy" in row:
        told += f", {row['fine_energy']:.0f} by fine"
    return f"after {row['played']} sweeps {told}; ours {row['ours_fine_energy']:.0f} by fine"


def main() -> None:
    """Race in every configuration, print tables, write the JSON."""
    parser = common.options(__doc__ or "", "race", peer=True)
    parser.add_argument("--quick", action="store_true", help="n = 500 only")
    parser.add_argument("--repeats", type=int, default=3, help="turns of each contender")
    parser.add_argument("--budget", type=float, default=5.0, help="seconds for a peer's sweeps, else extrapolated")
    parser.add_argument(
        "--resolutions", nargs="+", default=RESOLUTIONS, help="of ours; energies are those of the first"
    )
    arguments = parser.parse_args()
    jt.use_cores(1)
    peer, results = find_peer(arguments.peer), []
    for radius, n in product((1.0, 5.0), (500,) if arguments.quick else (100, 500, 1000)):
        results.append(race(radius, n, peer, arguments))
        report(results[-1])
    common.write(arguments.out, {"budget_seconds": arguments.budget, "results": results})


if __name__ == "__main__":
    main()
