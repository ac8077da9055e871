"""What engineers ask of a run: computed from its frames when it is asked for, frame by frame."""
