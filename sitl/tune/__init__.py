"""Tuning of followers' gains on scenes that no campaign tests with."""
