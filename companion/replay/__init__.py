"""A recorded flight once more: its packets through the code that flies, and what came out differently."""
