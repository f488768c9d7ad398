"""The paper, claim by claim and figure by figure, from the simulated rig's raw counts."""
