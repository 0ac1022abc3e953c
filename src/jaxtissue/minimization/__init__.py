"""Minimization of the energy: its gradient, and methods that go down it."""
