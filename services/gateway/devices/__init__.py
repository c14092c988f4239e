"""Who may post: enrolment, consents, tokens, what is stored of a device."""
