"""Chains of links that swim: shape, joints, motion, the coupling's other side."""
