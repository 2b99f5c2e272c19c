"""Inverse kinematics: the least displacement that meets the constraints of each frame (§5)."""
