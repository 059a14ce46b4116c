"""Optimisation and integration of the objective: Levenberg-Marquardt, sequential Monte Carlo, importance sampling."""
