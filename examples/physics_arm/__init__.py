"""A robot arm in the physics engine MuJoCo that corrects an object's pose over REST.

    python -m examples.physics_arm --seeds 3

Nothing here knows how pretouch works inside: arm, camera, finger and truth are the engine's, and pretouch is asked
over HTTP.
"""
