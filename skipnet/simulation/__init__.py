"""Simulated scenes and scanners, in place of the paper's UE4 and AirSim."""

from __future__ import annotations
