"""Planners over a dynamics model: CEM, Gradient-CEM, the true simulator as oracle, closed loop."""
