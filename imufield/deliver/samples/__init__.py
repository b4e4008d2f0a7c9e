"""Samples handed on: raw tables, ROS 2 bags, corrected recordings."""
