"""The fluid and the swimming robot; see the README for what exists so far."""
