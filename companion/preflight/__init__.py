"""Go or no-go before a flight: one line per check, each with its reason."""
