"""Will a model work on these images? What it was trained for beside what it meets, and what its poses explain"""
