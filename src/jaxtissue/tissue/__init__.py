"""Measurement of all cells of a tissue, once or repeatedly; cells with large error estimates are traced."""
