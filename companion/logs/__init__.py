"""Flight logs: channels, MCAP files, reports."""
