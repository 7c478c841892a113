"""Solve a problem by `fit` or `fit_map`, and compute from its result bands, plans and budgets."""
