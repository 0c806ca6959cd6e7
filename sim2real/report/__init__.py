"""Tables for the terminal, figures and HTML pages.

Matplotlib and Jinja are imported only when a figure or page is made.
"""
