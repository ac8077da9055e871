"""The adjoint of Radau IIA: back through a run's steps, each one block system of its stages."""
