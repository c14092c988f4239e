"""What would a phone measure, when, on which clock, and how does it reach the gateway?"""
