"""The operations of a driver: how an error's size follows the state of the machine."""
