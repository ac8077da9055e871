"""Small motions about a state: modes, state space, frequency response."""
