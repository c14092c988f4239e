"""The door for phones: enrolment and consent, sensor batches over HTTP, dead reckoning, radio scans."""
