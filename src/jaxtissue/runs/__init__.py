"""Output folders: settings, one run, a grid of runs, tables, plots."""
