"""Learning where to sense: labels, the dataset that they make up, and the training of proposer `deep`.

Only `network`, `loss` and what trains need torch.
"""
