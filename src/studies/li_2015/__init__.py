"""The tunnel sections of Li et al. (2015), tried on a simulated campaign.

    register_campaign      stations registered one by one and all together
    thirteen_parameters    the printed model of registration, and its start
    registration_accuracy  errors of registration beside the stated ones; joints of neighbours
    wrong_pairs            a target taken for another
    epoch_shift            shift between the epochs that comes from registration
    sticker_accuracy       scans against the total station
    epoch_cloud            all points of an epoch; campaign_contents counts them
    printed_axis           quadratics through the middles between extreme points
    axis_accuracy          errors of the axes, and causes that pull the printed one
    filter_accuracy        points found and lost by the filter, and the deformation it takes off
    section_density        points in a section, and directions without any
    simulated_sections     single sections in both epochs, drawn many times
    motion_and_shape       mean change, motion of the ring, and change of shape
    hidden_deformation     what ellipses hide, from their residuals
    section_accuracy       deformation of these sections beside the truth
    false_alarms           of the printed limits, by noise alone
    calibration            whether intervals and tests hold what they state
    cable_tray             a tray that pulls the ellipses
    printed_ellipse        the ellipsoid of the paper
    verdicts               judgement of the printed numbers

The simulated campaign is :mod:`studies.simulation.tunnel`.
"""
