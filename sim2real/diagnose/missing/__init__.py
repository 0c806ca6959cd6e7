"""Which physics of the catalogue do recordings show that the fitted servo lacks?"""
