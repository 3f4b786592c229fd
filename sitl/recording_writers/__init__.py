"""Emulated (or flown) datagrams written in the formats in which users record a Mid-360."""
