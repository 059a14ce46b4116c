"""The network of proposer `deep`: its inputs and its architecture.

Only the torch modules need torch.
"""
