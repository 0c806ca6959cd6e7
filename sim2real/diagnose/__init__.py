"""Find the missing physics: is there a mismatch, where, what was left out, and what to do next."""
