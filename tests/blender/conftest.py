"""What runs inside Blender is no test."""

collect_ignore = ["living.py", "showing.py", "walker.py"]
