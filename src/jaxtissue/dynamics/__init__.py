"""How a tissue moves: proposals, independent sets, Metropolis-Hastings sweeps, annealing."""
