"""The linear program of an estimate: the terms and constraints that observations give it (sections 3 and 4)."""
