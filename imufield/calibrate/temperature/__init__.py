"""Bias and scale over temperature: from sessions at several temperatures and from ramps in one pose."""
