"""Learning where to sense: labels, the dataset that they make up, and the training of proposer `deep`.

`dataset`, `trials`, `targets`, `augment` and `curves` do not need torch.
"""
