"""Do set-points reach the servos late, irregularly, or not at all?"""
