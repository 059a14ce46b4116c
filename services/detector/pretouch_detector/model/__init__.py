"""The network of proposer `deep`: what it sees of a scene, and how it is built.

Only the torch modules need torch.
"""
