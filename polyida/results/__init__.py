"""Results derived from the frames of a run: energies, reactions, stresses, section forces."""
