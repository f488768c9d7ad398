"""τ and ψ'_QS from every forward row of a whole record, in stall and out of it."""
