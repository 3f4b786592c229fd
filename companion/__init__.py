"""Companion: the flight-stack companion application for PX4 swarms without GNSS or communication."""

__version__ = "0.1.0"
