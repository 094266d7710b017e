# The ROS 2 wheels export CMake targets whose include folders name the host that built them
# (/opt/python/...); CMake stops on folders that do not exist. Passed as CMAKE_PROJECT_INCLUDE,
# this drops them once a project is configured. Packages need no line for it.
if(NOT DEFINED _LPV_WHEELS_FIX)
  set(_LPV_WHEELS_FIX TRUE)

  function(_lpv_drop_missing_includes)
    get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
    foreach(target IN LISTS targets)
      get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
      if(includes)
        set(kept "")
        foreach(folder IN LISTS includes)
          if(NOT folder MATCHES "^/opt/python/" OR EXISTS "${folder}")
            list(APPEND kept "${folder}")
          endif()
        endforeach()
        set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
      endif()
    endforeach()
  endfunction()

  cmake_language(DEFER CALL _lpv_drop_missing_includes)
endif()
