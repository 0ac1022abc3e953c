"""Curves: they show the tables' means beside the paper's numbers, with named axes and units."""

import io

import numpy as np
import pytest
from test_claims import ratios, runs, times

from jaxtissue.reproduction import published
from jaxtissue.reproduction.figures import plot_runs, plot_times, plot_volume_ranks
from jaxtissue.reproduction.ratio_figures import plot_kinds, plot_neighbors, plot_transitions
from jaxtissue.topology.neighbor_law import fit_neighbor_law


def rendered(figure):
    """The size of the figure as a file, which fails for what can't be drawn."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=50)
    return file.tell()


def line(axes, label):
    """The line of a label."""
    return next(line for line in axes.lines if line.get_label() == label)


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_times_stand_beside_the_papers():
    figure, axes = plot_times(times()["table1"])
    assert rendered(figure) and "seconds" in axes[0].get_ylabel() and axes[0].get_xlabel() == "cells"
    name = "MH, whole diagrams (extrapolated), $R_a$ = 1"
    ours, theirs = line(axes[0], name), line(axes[0], "the paper's MH, $R_a$ = 1")
    assert list(ours.get_ydata()) == list(theirs.get_ydata()) == [47.1, 703.8, 2525.0]
    assert list(line(axes[1], "near, $R_a$ = 5").get_ydata()) == [10, 14, 15]
    assert theirs.get_markerfacecolor() == "white"


@pytest.mark.parametrize("as_paper", [True, False])
def test_runs_show_means_and_mark_the_paper_only_for_its_own_size(as_paper):
    table = runs() | {"rounds_so_far": 40 * runs()["sweep"]}
    figure, axes = plot_runs(table, as_paper)
    assert rendered(figure) and all("units" in panel.get_ylabel() for panel in axes.flat)
    assert any("paper" in label for label in labels(axes[0, 0])) == as_paper
    shown = line(axes[0, 0], "$R_a$ = 1").get_ydata()
    assert shown[0] == pytest.approx(320_000 * 1.02)  # the mean of 1, 1.02 and 1.04
    assert list(line(axes[0, 1], "$R_a$ = 1, 40 rounds a sweep").get_xdata()[:2]) == [0, 40]


def test_volumes_by_rank():
    rank = np.tile(np.arange(1, 11), 4)
    table = {"sweep": np.repeat([0, 5], 20), "rank": rank, "volume": 10.0 * rank, "axial": 1.0 * rank}
    figure, axes = plot_volume_ranks(table | {"is_end": rank < 3}, 55.0, 11.0)
    assert rendered(figure) and "length units³" in axes[0].get_ylabel() and "%" in axes[1].get_ylabel()
    assert list(line(axes[0], "sweep 5").get_ydata()) == list(10.0 * np.arange(1, 11))


def test_curves_against_the_ratio_name_axes_tissues_and_the_paper():
    table = ratios()
    law = fit_neighbor_law(table["ratio"], table["neighbors"])
    for figure, axes in (plot_neighbors(table, law), plot_transitions(table, law), plot_kinds(table)):
        assert rendered(figure)
        assert all("R_b / R_a" in panel.get_xlabel() and panel.get_ylabel() for panel in axes)
        assert any("paper" in label for panel in axes for label in labels(panel))
    _, axes = plot_neighbors(table, None)
    paper = line(axes[0], "paper, read off its Fig. 12")
    assert dict(zip(*paper.get_data(), strict=True)) == published.NEIGHBORS
    found = line(axes[1], "walls of at least 5 % of the mean")
    assert found.get_ydata()[0] == pytest.approx(0.95 * line(axes[1], "every wall").get_ydata()[0])
