"""Kojima, Yoshimoto and Yamamoto 2023 (doi 10.3389/frobt.2023.1157911), done again: their figures
and numbers beside ours.
"""
