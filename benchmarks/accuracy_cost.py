"""Error against time per diagram: every estimator and resolution, the exact path, and the C++ peer.

500 random cells, L = 100, R_b = 10. Errors are rms over cells / mean cell. The reference of R_a = 5 is the
high-precision tube. There is none of R_a = 1: there it is our exact path with 100 samples a backbone, which
is truer than lines on the tubes that have a reference (`ratio10_n100`: V 2e-6 and A 1e-4 of the mean cell;
lines at 24x24 3e-5 and 5e-4). The peer uses one thread; ours is timed both on the whole machine and on one
core.
"""

from itertools import product
from pathlib import Path
from typing import Any

import common
import contenders
import numpy as np
from frontier import draw
from peer import find_peer

import jaxtissue as jt

LAYERS, DENSITIES = (3, 4, 5, 6, 7, 8, 10), (3, 4, 5, 6, 7, 8, 10)
# from scratch, and on one core
FEW = ((3, 3), (4, 4), (5, 5), (5, 6), (7, 8), (8, 8), (10, 10), (3, 4), (4, 3.3), (4, 12), (7, 32))
VOXELS = (1.0, 0.5, 0.25)
EXACT = (5, 10, 20, 50, 100)
PEER = (4, 5, 10, 20, 50)
ROUNDS = 3


def references() -> dict[str, common.Truth]:
    """True sizes in each case."""
    place, tube = contenders.tissue(contenders.CASES[0])
    known = np.load(common.REFERENCES / "paper_Ra5.npz")
    cells = np.arange(len(known["V"]))
    truths = (common.true_sizes(place, tube), common.Truth(cells, known["V"], known["lateral"]))
    return dict(zip(contenders.CASES, truths, strict=True))


def plan(quick: bool) -> list[tuple[str, str, Any]]:
    """The contenders: threads (`whole` machine, `one` core), kind and size."""
    few = [tuple(size) for size in (FEW[1:5] if quick else FEW)]
    grid = few if quick else list(product(LAYERS, DENSITIES))
    grid += [size for size in [*map(tuple, jt.PRESETS.values()), *few] if size not in grid]
    rows = [("whole", "kept", size) for size in grid]
    rows += [("one", "kept", size) for size in few]
    rows += [
        (threads, kind, size)
        for kind in ("checked", "complete", "scratch")
        for size in few
        for threads in ("whole", "one")
    ]
    rows += [("whole", "voxels", size) for size in (VOXELS[:1] if quick else VOXELS)]
    rows += [("one", "exact", size) for size in (EXACT[:2] if quick else EXACT)]
    return rows + [("one", "peer", size) for size in (PEER[:3] if quick else PEER)]


def measure(arguments: Any) -> list[dict[str, Any]]:
    """Every contender in every case, one after the other and that several times over."""
    peer, at_work = find_peer(arguments.peer), contenders.workers()
    rows: dict[tuple, dict[str, Any]] = {}
    truths = references()
    for _, case in product(range(1 if arguments.quick else ROUNDS), contenders.CASES):
        for threads, kind, size in plan(arguments.quick):
            row = rows.setdefault((case, threads, kind, size), {"times": []})
            absent = not peer if kind == "peer" else threads not in at_work
            if absent or sum(row["times"]) > 5:  # a long one is not repeated
                continue
            if kind == "peer" and peer:
                found = peer.diagram(*contenders.tissue(case), size)
                seconds, sizes = found.seconds, {"volume": found.volume, "lateral_area": found.lateral_area}
            else:
                told = at_work[threads].ask(case, kind, size)
                seconds, sizes = told["seconds"], told["sizes"]
                row.setdefault("first_seconds", told["first_seconds"])
            row["times"].append(seconds)
            row |= {"case": case, "threads": threads, "kind": kind, "size": size}
            row |= errors(truths[case], sizes, kind == "exact" and size == 100 and case == contenders.CASES[0])
    for worker in at_work.values():
        worker.close()
    measured = [row for row in rows.values() if row["times"]]
    for row in measured:
        row["seconds"] = float(np.median(row["times"]))
    return measured


def errors(truth: common.Truth, sizes: dict[str, Any], is_reference: bool) -> dict[str, float | None]:
    """Errors of V and A; None where a size is not measured, or is the reference itself."""
    pairs = (("volume", truth.volume), ("lateral_area", truth.lateral_area))
    return {
        name: common.rms(sizes[name], exact) if name in sizes and not is_reference else None for name, exact in pairs
    }


def cheapest(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each case and pair of bars the fastest of ours and of the peer that meet both, and their ratio.

    Bars are those of the race, and each of the peer's own errors.
    """
    met = []
    for case in contenders.CASES:
        measured = [row for row in rows if row["case"] == case and row["lateral_area"] is not None]
        met += [line for name, most in bars(measured).items() for line in fastest(measured, case, name, most)]
    return met


def bars(rows: list[dict[str, Any]]) -> dict[str, tuple[float, float]]:
    """Errors V and A that are asked for, by name."""
    own = {f"s = {row['size']}": row for row in rows if row["kind"] == "peer"}
    return common.BARS | {name: (row["volume"], row["lateral_area"]) for name, row in own.items()}


def fastest(rows: list[dict[str, Any]], case: str, bar: str, most: tuple[float, float]) -> list[dict[str, Any]]:
    """The fastest of each kind of ours within a pair of bars, beside the peer's."""
    good = [row for row in rows if row["volume"] <= most[0] and row["lateral_area"] <= most[1]]
    peers = [row for row in good if row["kind"] == "peer"]
    best, met = min(peers, key=lambda row: row["seconds"], default=None), []
    for kind, threads in product(("kept", "checked", "complete", "scratch"), ("whole", "one")):
        ours = [row for row in good if (row["kind"], row["threads"]) == (kind, threads)]
        first = min(ours, key=lambda row: row["seconds"], default=None)
        if first:
            line = {"case": case, "bar": bar, "errors": most, "kind": kind, "threads": threads}
            line |= {"size": first["size"], "ms": 1e3 * first["seconds"]}
            line |= {"peer_samples": best and best["size"]}
            met.append(line | {"ratio": best and best["seconds"] / first["seconds"]})
    return met


def report(rows: list[dict[str, Any]], met: list[dict[str, Any]]) -> None:
    """Print every row, then the contender that meets each bar at the lowest cost."""
    print(f"{'case':8} {'kind':9} {'threads':8} {'size':>9} {'V %':>8} {'A %':>8} {'ms':>9}")
    for row in rows:
        marks = [f"{100 * row[key]:8.4f}" if row[key] is not None else 8 * " " for key in ("volume", "lateral_area")]
        print(
            f"{row['case']:8} {row['kind']:9} {row['threads']:8} {named(row['size']):>9}",
            f"{marks[0]} {marks[1]} {1e3 * row['seconds']:9.2f}",
        )
    for line in met:
        volume, area = line["errors"]
        beside = f"{line['ratio']:.1f} times faster than the peer, s = {line['peer_samples']}" if line["ratio"] else ""
        print(
            f"{line['case']}, V {volume:.3%} A {area:.2%}: {line['kind']:8} {line['threads']:5}",
            f"{named(line['size']):>6} {line['ms']:7.2f} ms {beside}",
        )


def named(size: Any) -> str:
    """A resolution as 6x8, or a number."""
    return "x".join(map(str, size)) if isinstance(size, list | tuple) else f"{size:g}"


def main() -> None:
    """Measure, print, write JSON and picture."""
    parser = common.options(__doc__ or "", "accuracy_cost", peer=True)
    parser.add_argument("--quick", action="store_true", help="a few sizes, once")
    arguments = parser.parse_args()
    path: Path = arguments.out
    rows = measure(arguments)
    met = cheapest(rows)
    report(rows, met)
    common.write(path, {"rows": rows, "cheapest": met})
    draw(rows, contenders.CASES).savefig(path.with_suffix(".png"), dpi=120)


if __name__ == "__main__":
    main()
