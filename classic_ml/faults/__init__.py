"""What a raw record gives away about its own readings: gaps, spikes, probes that disagree."""
