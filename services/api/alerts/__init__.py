"""What zones told and who looked at it: the inbox of alerts and the webhooks, in a database of their own."""
