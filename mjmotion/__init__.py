"""mjmotion: fit recorded motions to other ground, other bodies and other wishes, on MuJoCo."""

__version__ = "0.1.0"
