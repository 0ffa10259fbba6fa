"""Where the links of an elastic-joint robot really are."""
