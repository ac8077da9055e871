"""Pictures, reports, animations and exports of a trajectory or a comparison."""
