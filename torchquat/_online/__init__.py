"""Filters one frame at a time: what :mod:`torchquat.streaming` is made of.

A frame has few numbers, so calls are what it costs: everything here works on all joints, people and
frames of a window in one call. Nothing here has derivatives.
"""
