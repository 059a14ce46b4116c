"""How the objective is searched and summed up: Levenberg-Marquardt, sequential Monte Carlo, importance sampling."""
