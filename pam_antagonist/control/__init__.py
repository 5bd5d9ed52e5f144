"""The paper's PI controller, the control law through the model, and the references that they follow."""
