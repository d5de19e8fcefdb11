# SPDX-License-Identifier: Apache-2.0
# The wheels of ROS name include folders of the machine that built them, and CMake stops at a folder
# that does not exist. At the end of this directory such folders are taken from the imported targets
# of the Python generator. An installation from apt has none, and nothing changes.

function(_drop_missing_include_folders)
  get_directory_property(targets IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    if(target MATCHES "__rosidl_generator_py$")
      get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
      set(existing)
      foreach(folder IN LISTS folders)
        if(folder MATCHES "^\\$<" OR IS_DIRECTORY "${folder}")
          list(APPEND existing "${folder}")
        endif()
      endforeach()
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${existing}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL _drop_missing_include_folders)
