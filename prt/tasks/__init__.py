"""What varies, what is predicted, what it is tested on."""
