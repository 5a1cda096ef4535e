"""What every room relies on and no reader comes for: errors, checks, constants, devices, the command line."""
