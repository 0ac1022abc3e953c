"""The dynamics of a tissue: proposals, independent sets, Metropolis-Hastings sweeps, annealing."""
