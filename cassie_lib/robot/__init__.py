"""The robot: parameters, model, state schema, kinematics and pictures."""
