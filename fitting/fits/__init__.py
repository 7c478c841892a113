"""`fit` and `fit_map`: a stated problem solved, and what its `Fit` tells: bands, plans, budgets."""
