"""The networks of proposer `deep`: what they see of a scene, and how they are built.

Only the torch modules need torch.
"""
