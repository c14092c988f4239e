"""Where a phone's steps lead: attitude, heading, stride, from inertial samples to steps on the plan."""
