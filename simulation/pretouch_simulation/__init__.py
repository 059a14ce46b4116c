"""Everything that stands in for a real cell: objects, a depth camera, a finger, a robot, and the evaluation on them."""
