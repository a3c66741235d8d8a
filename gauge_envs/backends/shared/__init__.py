"""What backends share: values of contact pairs, states of rigid bodies, snapshots, grids of deformable bodies."""
