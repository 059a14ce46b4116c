"""Learning where to sense: labels, the dataset that they make up, and the training of proposer `deep`.

`dataset`, `trials`, `targets`, `augment`, `schedule` and `curves` do not need torch.
"""
