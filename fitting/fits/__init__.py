"""`fit` and `fit_map`, which solve a problem, and the results of a `Fit`: bands, plans, budgets."""
