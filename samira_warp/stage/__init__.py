"""What stands round an avatar when it is looked at, whoever looks.

Lights, background, turntable and sheets of pictures, free of any one command.
"""
