"""Learned dynamics: the thesis's two models and a causal one with a key-value cache."""
