"""Who can matter to whom: candidates, complete by an exact sum, and the few that matter soon."""
