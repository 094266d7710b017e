"""The certificate of a serial arm's computed-torque loop, and its check without any solver."""
