"""What the papers measured, measured here: experiments as lists of independent jobs, what runs them, and what reports them."""
